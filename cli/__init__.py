"""The ``idapt`` command."""

import idapt_pl as idapt_pl  # sets the rendering backend before anything else can import mujoco
