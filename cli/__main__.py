"""``python -m cli`` is the ``idapt`` command."""

import sys

from cli.main import main

sys.exit(main())
