"""Planning of experiments: figures of a scene before anything is built."""

from __future__ import annotations
