"""The plan of a data set: scene with distributions, seed, count and splits. ``dataset.toml``."""

import tomllib
from functools import lru_cache
from typing import Annotated, Any, Literal, Self

import tomli_w
from pydantic import Field, model_validator

from scenes.scene import Scene
from scenes.scene_files import dumps, parse
from scenes.support.errors import DatasetError, ImpossibleError, SceneError
from scenes.support.frozen import Frozen
from scenes.support.safe_parse import parse_toml
from scenes.support.validation_words import in_words

PLAN_FILE = "dataset.toml"
# Files of every sample, and those that a plan may ask for.
ALWAYS = ("stack.exr", "truth.exr", "scene.toml", "labels.json")
PICTURE = "picture.png"
HEIGHTS = ("height.png", "reconstruction.exr")
COLOUR = "colour.png"
MODULATION = "modulation.png"
HEIGHT_TIFF = "height.tiff"
ON_REQUEST = {
    "picture": (PICTURE,),
    "heights": HEIGHTS,
    "ring_light": (COLOUR,),
    "modulation": (MODULATION,),
    "height_tiff": (HEIGHT_TIFF,),
}
EVERY_FILE = (*ALWAYS, *(name for names in ON_REQUEST.values() for name in names))
SPLITS = {"train": 0.8, "val": 0.1, "test": 0.1}

# The order of splits repeats after so many lights.
BLOCK = 10_000

SplitName = Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_-]*$", max_length=32)]
Share = Annotated[float, Field(gt=0.0, le=1.0)]


class DatasetPlan(Frozen):
    """Everything that decides a data set's bytes."""

    format: Literal[2] = 2
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 0
    count: Annotated[int, Field(ge=1, le=10_000_000)]
    """Samples; it may grow later, as sample i depends on the seed and i alone."""
    splits: Annotated[dict[SplitName, Share], Field(min_length=1)] = SPLITS
    """Share of each split; the shares sum to 1."""
    picture: bool = True
    """Each sample has ``picture.png``."""
    heights: bool = False
    """Each sample has measured heights: ``height.png`` and ``reconstruction.exr``."""
    ring_light: bool = False
    """Each sample has ``colour.png``, a picture under ring lights."""
    modulation: bool = False
    """Each sample has its measured modulation at the shortest exposure, ``modulation.png``."""
    height_tiff: bool = False
    """Each sample has its measured heights as floating-point millimetres, ``height.tiff``."""
    variants: Annotated[int, Field(ge=1, le=1000)] = 1
    """Samples that share one light and differ in noise, and in what is drawn for sensor and exposures."""
    made_with: dict[str, str] = {}
    """Versions and kind of processor that decide the last bits; filled in by the machine that makes the first sample."""
    scene: dict[str, Any]
    """The scene as TOML tables, distributions not yet drawn."""

    @model_validator(mode="after")
    def _whole(self) -> Self:
        total = sum(self.splits.values())
        if abs(total - 1.0) > 1e-9:
            raise ValueError(f"splits {self.splits} sum to {total:g}: make it 1")
        return self

    @classmethod
    def of(
        cls,
        scene: Scene,
        count: int,
        seed: int = 0,
        splits: dict[str, float] | None = None,
        **asked: Any,
    ) -> Self:
        """The plan of `count` samples of a scene; `asked`: this class's other fields. `DatasetError` if there cannot be
        one.
        """
        try:
            return cls(
                seed=seed,
                count=count,
                splits=SPLITS if splits is None else splits,
                scene=tomllib.loads(dumps(scene)),
                **asked,
            )
        except ImpossibleError as error:
            raise DatasetError(
                f"invalid data set: {str(error).removeprefix(f'{cls.__name__}.')}"
            ) from None

    @classmethod
    def loads(cls, text: str, where: str) -> Self:
        """The plan of a ``dataset.toml``; `DatasetError` for anything else."""
        try:
            tree = parse_toml(text)
            if tree.get("format") == 1:
                raise DatasetError(
                    f"'{where}' has format 1, whose samples have no picture.png: continue it with the version that made "
                    "it, or start another data set"
                )
            return cls.model_validate(tree)
        except ValueError as error:
            raise DatasetError(
                f"'{where}' is not the plan of a data set: {in_words(error)}"
            ) from None

    def dumps(self) -> str:
        """The plan as TOML."""
        return tomli_w.dumps(self.model_dump(mode="json", exclude_none=True))

    @property
    def sample_files(self) -> tuple[str, ...]:
        """Names of the files of every sample."""
        asked = (names for key, names in ON_REQUEST.items() if getattr(self, key))
        return (*ALWAYS, *(name for names in asked for name in names))

    def load_scene(self) -> Scene:
        """The scene that samples are drawn from."""
        try:
            return parse(tomli_w.dumps(self.scene), where="the data set's scene")
        except SceneError as error:
            raise DatasetError(f"this version cannot make the data set's scene: {error}") from error

    def light_of(self, index: int) -> int:
        """Number of a sample's light; variants share it."""
        return index // self.variants

    def split_of(self, index: int) -> str:
        """The split of a sample: by its light's number alone, so that neither seed nor count moves a sample.

        Of the first n lights, each split has its share of n, to less than one light.
        """
        return _split_order(tuple(self.splits.items()))[self.light_of(index) % BLOCK]

    def require_same(self, other: "DatasetPlan", where: str) -> None:
        """`DatasetError` unless this plan continues the plan `other`, found at `where`."""
        if self.scene != other.scene:
            keys = sorted(_differing(other.scene, self.scene))
            raise DatasetError(
                f"'{where}' holds a data set of another scene (they differ in {', '.join(keys[:5])}): "
                "use the same scene and settings to continue it, or another folder"
            )
        for key in ("seed", "splits", "variants", *ON_REQUEST):
            old, new = getattr(other, key), getattr(self, key)
            if old != new:
                raise DatasetError(
                    f"'{where}' holds a data set of {key} {old}, not {new}: use {old} to continue it, "
                    "or another folder"
                )
        if self.count < other.count:
            raise DatasetError(
                f"'{where}' holds a data set of {other.count} samples, {self.count} were asked for: it can grow, "
                "not shrink; use another folder"
            )

    def require_maker(self, mine: dict[str, str]) -> None:
        """`DatasetError` where this machine would make other bytes than the one that made the first sample."""
        for name, version in self.made_with.items():
            if mine.get(name) != version:
                raise DatasetError(
                    f"the data set is made with {name} {version}, here is {mine.get(name) or 'none'}: samples would "
                    "differ in their last bits; use the same, or start another data set"
                )


@lru_cache(maxsize=8)
def _split_order(splits: tuple[tuple[str, float], ...]) -> tuple[str, ...]:
    """Split of each light of a block: always the one that is farthest below its share."""
    taken = dict.fromkeys((name for name, _ in splits), 0)
    order = []
    for count in range(1, BLOCK + 1):
        name = max(splits, key=lambda split: split[1] * count - taken[split[0]])[0]
        taken[name] += 1
        order.append(name)
    return tuple(order)


def _differing(old: Any, new: Any, at: str = "") -> list[str]:
    """Dotted keys in which two trees differ."""
    if isinstance(old, dict) and isinstance(new, dict):
        keys = old.keys() | new.keys()
        return [d for k in keys for d in _differing(old.get(k), new.get(k), f"{at}.{k}".strip("."))]
    if isinstance(old, list) and isinstance(new, list) and len(old) == len(new):
        pairs = enumerate(zip(old, new, strict=True))
        return [d for i, (a, b) in pairs for d in _differing(a, b, f"{at}.{i}")]
    return [] if old == new else [at]
