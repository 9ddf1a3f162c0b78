"""A small scene with bubbles that several tests change."""

from typing import Any

from sabench.scenes import Scene, parse_scene


def small(**changes: Any) -> Scene:
    """Five cameras in a cross before a tank with two dozen bubbles. `changes` replace tables."""
    bubbles = {"generator": "bubble_field", "count": 24, "radius_mm": 0.8, "radius_spread": 0.3}
    sensor = {"full_well_e": 20000.0, "read_noise_e": 10.0, "gain_dn_e": 0.2, "bit_depth": 12}
    values: dict[str, Any] = {
        "title": "small",
        "volume": {"center_mm": [0.0, 0.0, 60.0], "size_mm": [24.0, 18.0, 16.0]},
        "grid": {"voxel_mm": [0.25, 0.25, 0.25]},
        "wall": {"fluid_index": 1.333, "depth_mm": 120.0, "layers": [GLASS], "rear": [GLASS]},
        "cameras": few_pixels(128, 160, 0.017)
        | {"layout": {"kind": "cross", "arm": 1, "spacing_mm": 120.0}},
        "backlight": {"center_mm": [0.0, 0.0, 400.0], "size_mm": [260.0, 260.0]},
        "sensor": sensor | {"exposure_s": 1e-4},
        "bubbles": bubbles | {"radius_range_mm": [0.5, 1.6]},
    } | changes
    return parse_scene({key: one for key, one in values.items() if one is not None}, "small")


def few_pixels(rows: int, columns: int, pixel_mm: float) -> dict[str, Any]:
    """Two cameras of few pixels, for tests that do not look at images."""
    size = {"rows": rows, "columns": columns, "pixel_mm": pixel_mm}
    lens = {"focal_length_mm": 50.0, "f_number": 11.0, "center_mm": [0.0, 0.0, -520.0]}
    return {**size, **lens, "layout": {"kind": "line", "count": 2, "spacing_mm": 120.0}}


GLASS = {"index": 1.52, "thickness_mm": 8.0}
PLATE: dict[str, Any] = {"generator": "code_plate", "columns": 6, "rows": 5, "cell_mm": 2.0}
PLATE |= {"place_mm": [0.0, 0.0, 66.0], "material": {"reflectance": 0.0}}
CURTAIN: dict[str, Any] = {"generator": "bubble_field", "count": 14, "radius_mm": 1.2}
CURTAIN |= {"radius_spread": 0.1, "radius_range_mm": [0.9, 1.6]}
CURTAIN |= {"low_mm": [-9.0, -8.0, 28.0], "high_mm": [9.0, 8.0, 40.0]}
VOLUME = {"center_mm": [0.0, 0.0, 48.0], "size_mm": [24.0, 18.0, 40.0]}
LASER: dict[str, Any] = {"pulse_energy_mj": 200.0, "direction": [1.0, 0.0, 0.0]}
LASER |= {"sheet_normal": [0.0, 0.0, 1.0], "thickness_mm": 16.0, "height_mm": 18.0}
