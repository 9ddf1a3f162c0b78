"""Page that shows a rig, a data set or a result in space."""

from __future__ import annotations
