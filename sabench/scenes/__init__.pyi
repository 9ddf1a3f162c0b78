from .build import Rig as Rig, build_rig as build_rig
from .bundled import find as find
from .json_schema import scene_schema as scene_schema
from .loading import load_scene as load_scene, parse_scene as parse_scene
from .scene import Scene as Scene
from .world import (
    BubbleWorld as BubbleWorld,
    ParticleWorld as ParticleWorld,
    TargetWorld as TargetWorld,
    World as World,
)
