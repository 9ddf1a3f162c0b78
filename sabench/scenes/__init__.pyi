from .build import Rig as Rig
from .build import build_rig as build_rig
from .bundled import find as find
from .json_schema import scene_schema as scene_schema
from .loading import load_scene as load_scene
from .loading import parse_scene as parse_scene
from .scene import Scene as Scene
from .world import (
    BubbleWorld as BubbleWorld,
)
from .world import (
    ParticleWorld as ParticleWorld,
)
from .world import (
    TargetWorld as TargetWorld,
)
from .world import (
    World as World,
)
