"""Packages of the extra `full`, which scoring does without."""

# by the names of their modules; docs/developing/dependencies.md says what each is for
# fmt: off
FULL = frozenset({
    "OpenEXR", "cv2", "drjit", "jinja2", "matplotlib", "mitsuba", "skimage", "threadpoolctl",
    "trimesh", "vl_convert",
})
# fmt: on


def lacking(error: Exception) -> str | None:
    """Say which package of the extra `full` is missing; None for other errors."""
    name = error.name if isinstance(error, ModuleNotFoundError) else None
    module = (name or "").partition(".")[0]
    if module not in FULL:
        return None
    return (
        f"the package {module} is not installed, which scoring does without: "
        "pip install 'sabench[full]' installs all"
    )
