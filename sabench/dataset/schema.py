"""Names, keys and checks that writer, reader and verification share."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field

from sabench.api.truth import Target
from sabench.utils.arrays import LARGEST
from sabench.utils.errors import InputError
from sabench.utils.files import canonical_json, digest, inside, read_json, sha256
from sabench.utils.validation import Model, validate

FORMAT = "sabench-dataset"
VERSION = 1
SAMPLES_VERSION = 2  # of a data set of independent samples in shards
MANIFEST, SCENE, TRUTH = "manifest.json", "scene.toml", "truth.h5"
CAMERAS, TRUE_CAMERAS = "cameras.json", "true_cameras.json"
TARGET, POINTS = "target.json", "points.h5"
INDEX = "samples.csv"  # of independent samples: where each lies
MOST_SAMPLES = 100_000_000  # of a data set
MOST = 1_000_000  # frames, points of a target, pixels and voxels along a side
SIDES = ("observation", "truth")  # folders of shards
REFERENCES = "images.json"  # of a recorded data set whose images lie elsewhere
MASKS = "masks"  # folder of images that mark the pixels that count
PACK = {"compression": "gzip", "compression_opts": 1, "shuffle": True}  # of arrays in HDF5 files
GIVEN = "given"  # folder of files of other programs, which the scene reads


Hash = Annotated[str, Field(pattern="^[0-9a-f]{64}$")]


class StoredRecord(BaseModel):
    """Entry of a file of a data set."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class VersionedFile(StoredRecord):
    """File of a data set that names its format."""

    format: str
    version: int


class TargetFile(VersionedFile):
    """target.json: the calibration target that the frames show."""

    target: Target


class FileEntry(StoredRecord):
    """One file's size and checksum."""

    bytes: int = Field(ge=0)
    sha256: Hash

    @classmethod
    def of(cls, path: Path) -> FileEntry:
        """Measure a file."""
        return cls(bytes=path.stat().st_size, sha256=sha256(path))


class Contents(VersionedFile):
    """Contents of a data set, or of its observation side.

    `content_hash` is that of the whole data set in both.
    """

    content_hash: Hash
    files: dict[str, FileEntry]
    manifest_hash: Hash

    @property
    def all_files(self) -> dict[str, FileEntry]:
        """Files of the data set but the manifest."""
        return self.files


class Origin(Contents):
    """Contents of a data set with its truth, and its origin."""

    scene: str
    scene_hash: Hash
    seed: int = Field(ge=0)
    renderer: str
    versions: dict[str, str]


class Manifest(Origin):
    """manifest.json: contents and origin of a data set.

    `identity` is the same for all copies, independent of the processor: see `identity_of`. Data
    sets of before have none.
    """

    identity: Hash | None = None


class ObservationManifest(Contents):
    """manifest.json of the observation side alone, without the origin."""

    side: Literal["observation"]


class ShardEntry(StoredRecord):
    """One shard: its samples, and its files by side.

    A writer notes it next to the finished shard, and the manifest lists those of all shards.
    """

    name: str
    split: str
    first: int = Field(ge=0)
    last: int = Field(ge=0)
    samples: int = Field(ge=1)
    files: dict[str, FileEntry]


class ShardOrigin(StoredRecord):
    """Origin of a shard, which its writer notes with its entry.

    `key` is that of the stream.
    """

    seed: int = Field(ge=0)
    key: Hash
    entry: ShardEntry


class ShardedContents(Contents):
    """Contents of a data set of independent samples, or of its observation side.

    `files` lists all but those of shards, `size` is the number of samples of a full shard. The
    shape of images is (frame, camera, row, column).
    """

    samples: int = Field(ge=1, le=MOST_SAMPLES)
    shares: tuple[float, ...] = Field(min_length=1)
    size: int = Field(ge=1)
    shape: tuple[int, int, int, int]
    shards: tuple[ShardEntry, ...]

    @property
    def all_files(self) -> dict[str, FileEntry]:
        """Files of the data set but the manifest, those of shards included."""
        shards = ((name, one) for entry in self.shards for name, one in entry.files.items())
        return self.files | dict(shards)


class SamplesManifest(ShardedContents, Origin):
    """manifest.json of a data set of independent samples.

    `key` is that of the stream; `truth` lists what the shards of the truth hold.
    """

    key: Hash
    truth: tuple[str, ...]


class SamplesObservationManifest(ShardedContents):
    """manifest.json of the observation side of independent samples alone."""

    side: Literal["observation"]


class RecordedManifest(Contents):
    """manifest.json of a recorded data set, which has no truth.

    `source` names the recording; `versions` are those that imported it.
    """

    recorded: Literal[True]
    source: str
    versions: dict[str, str]


def image_name(camera: str, frame: int, suffix: str) -> str:
    """Name the path of an image in a data set: tif (grey values) or exr (radiance)."""
    return f"images/frame_{frame:04d}/{camera}.{suffix}"


def mask_name(camera: str) -> str:
    """Name the path of a camera's mask inside a data set."""
    return f"{MASKS}/{camera}.tif"


def shard_file(side: str, shard: str) -> str:
    """Name the path of a shard inside a data set."""
    return f"{side}/{shard}.h5"


def frame_group(frame: int) -> str:
    """Name the HDF5 group of a frame, in truth and result files."""
    return f"frames/{frame:04d}"


def content_hash(files: Mapping[str, FileEntry]) -> str:
    """Hash the files of a data set: SHA-256 over the JSON of path -> SHA-256."""
    return digest({name: entry.sha256 for name, entry in files.items()})


def identity_of(scene_hash: str, seed: int, renderer: str, simulation: str) -> str:
    """Hash what defines a data set, and not its bytes.

    Bytes differ between processors, which round differently. `simulation` is the version of the
    simulation, `sabench.utils.version.SIMULATION`.
    """
    keys = {"scene_hash": scene_hash, "seed": seed, "renderer": renderer, "simulation": simulation}
    return digest(keys)


def list_files(root: Path, measured: Mapping[str, FileEntry] | None = None) -> dict[str, FileEntry]:
    """Measure all files of a folder but the manifest, by their paths in it."""
    paths = sorted(path for path in root.rglob("*") if path.is_file())
    names = [path.relative_to(root).as_posix() for path in paths if path != root / MANIFEST]
    return {name: (measured or {}).get(name) or FileEntry.of(root / name) for name in names}


def write_manifest(root: Path, files: Mapping[str, FileEntry], **keys: Any) -> None:
    """Write the manifest of a data set; `keys` come before those of its files."""
    head = {
        "format": FORMAT,
        "version": VERSION,
        "content_hash": content_hash(files),
        "files": {name: entry.model_dump() for name, entry in files.items()},
    }
    (root / MANIFEST).write_text(seal(head | keys), encoding="utf-8")


def seal(manifest: dict[str, Any]) -> str:
    """Serialise the manifest, with the hash of all other keys."""
    rest = {key: value for key, value in manifest.items() if key != "manifest_hash"}
    return canonical_json({**rest, "manifest_hash": digest(rest)})


def is_observed(name: str) -> bool:
    """Return whether a file of a data set belongs to its observation side."""
    image = name.startswith(("images/", f"{MASKS}/")) and name.endswith(".tif")
    image = image or name.startswith(f"{SIDES[0]}/")
    return image or name in (CAMERAS, TARGET, POINTS, INDEX)


def read_manifest(root: Path) -> Contents:
    """Read the manifest of a data set, of its observation side or of a recorded one.

    Raises InputError if there is none, it is broken or of another format.
    """
    path = inside(root, MANIFEST)
    if not root.is_dir() or not path.is_file():
        found = "a file" if root.is_file() else "a folder without it" if root.is_dir() else "none"
        raise InputError(f"{root}: expected a data set folder with {MANIFEST}, found {found}")
    manifest: Contents = read_versioned(_kind_of(path), path)
    sealed = seal(manifest.model_dump(mode="json", exclude_none=True))
    if path.read_text(encoding="utf-8") != sealed:
        raise InputError(f"{path}: its manifest_hash does not match its content")
    if isinstance(manifest, Manifest) and manifest.identity is not None:
        origin = manifest.scene_hash, manifest.seed, manifest.renderer
        expected = identity_of(*origin, manifest.versions.get("simulation", ""))
        if manifest.identity != expected:
            raise InputError(
                f"{path}: identity: expected {expected[:12]} for its scene_hash, seed, renderer "
                f"and versions.simulation, got {manifest.identity[:12]}"
            )
    return manifest


def read_target(root: Path) -> Target:
    """Read the target of a data set for calibrations."""
    path = inside(root, TARGET)
    target = read_versioned(TargetFile, path).target
    if (
        min(target.columns, target.rows) < 1
        or target.columns * target.rows < 2
        or target.pitch_mm <= 0.0
        or not 0.0 <= target.mark_mm < target.pitch_mm
        or target.columns * target.rows > MOST
        or target.pitch_mm > LARGEST
    ):
        raise InputError(
            f"{path}: target: expected 2 to {MOST} points, a positive pitch_mm of at most "
            f"{LARGEST:g} and a smaller mark_mm, got {target}"
        )
    return target


def _kind_of(path: Path) -> type[Contents]:
    value = read_json(path)
    keys = value if isinstance(value, dict) else {}
    if keys.get("version") == SAMPLES_VERSION:
        return SamplesObservationManifest if "side" in keys else SamplesManifest
    if "side" in keys:
        return ObservationManifest
    return RecordedManifest if "recorded" in keys else Manifest


def read_versioned(model: type[Model], path: Path) -> Model:
    """Read a JSON file of this format and version."""
    return check_versioned(model, read_json(path), path)


def check_versioned(model: type[Model], value: Any, path: Path) -> Model:
    """Check what a JSON file of this format holds."""
    version = SAMPLES_VERSION if issubclass(model, ShardedContents) else VERSION
    if (
        not isinstance(value, dict)
        or value.get("format") != FORMAT
        or value.get("version") != version
    ):
        got = type(value).__name__
        if isinstance(value, dict):
            got = f"{value.get('format')!r} version {value.get('version')!r}"
        raise InputError(f"{path}: expected format {FORMAT!r} version {version}, got {got}")
    return validate(model, value, str(path))
