from .build import Rig as Rig, build_rig as build_rig
from .loading import (
    find as find,
    load_scene as load_scene,
    parse_scene as parse_scene,
    scene_schema as scene_schema,
)
from .scene import Scene as Scene
from .world import (
    BubbleWorld as BubbleWorld,
    ParticleWorld as ParticleWorld,
    TargetWorld as TargetWorld,
    World as World,
)
