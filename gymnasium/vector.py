"""None"""

from __future__ import annotations

import gymnasium

VectorEnv = gymnasium.vector.VectorEnv
