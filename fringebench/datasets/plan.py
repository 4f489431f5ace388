"""What a data set is: its scene with distributions, its seed, how many samples, their splits. ``dataset.toml``."""

import hashlib
import tomllib
from typing import Annotated, Any, Literal, Self

import tomli_w
from pydantic import Field, model_validator

from scenes.errors import DatasetError, ImpossibleError, SceneError
from scenes.foreign_text import parse_toml
from scenes.frozen import Frozen, in_words
from scenes.load import dumps, parse
from scenes.scene import Scene

NAME = "dataset.toml"
FORMAT = 1
SPLITS = {"train": 0.8, "val": 0.1, "test": 0.1}

SplitName = Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_-]*$", max_length=32)]
Share = Annotated[float, Field(gt=0.0, le=1.0)]


class Plan(Frozen):
    """Everything that decides a data set's bytes."""

    format: Literal[1] = 1
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 0
    count: Annotated[int, Field(ge=1, le=10_000_000)]
    """Samples; it may grow later, as sample i depends on the seed and i alone."""
    splits: Annotated[dict[SplitName, Share], Field(min_length=1)] = SPLITS
    """Share of each split; the shares sum to 1."""
    made_with: dict[str, str] = {}
    """Versions and kind of processor that decide the last bits; filled in by whoever makes the first sample."""
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
        cls, scene: Scene, count: int, seed: int = 0, splits: dict[str, float] | None = None
    ) -> Self:
        """The plan of `count` samples of a scene; `DatasetError` if there cannot be one."""
        try:
            return cls(
                seed=seed,
                count=count,
                splits=SPLITS if splits is None else splits,
                scene=tomllib.loads(dumps(scene)),
            )
        except ImpossibleError as error:
            raise DatasetError(
                f"a data set cannot be so: {str(error).removeprefix(f'{cls.__name__}.')}"
            ) from None

    @classmethod
    def loads(cls, text: str, where: str) -> Self:
        """The plan of a ``dataset.toml``; `DatasetError` for anything else."""
        try:
            return cls.model_validate(parse_toml(text))
        except ValueError as error:
            raise DatasetError(f"'{where}' is no plan of a data set: {in_words(error)}") from None

    def dumps(self) -> str:
        """The plan as TOML."""
        return tomli_w.dumps(self.model_dump(mode="json", exclude_none=True))

    def load_scene(self) -> Scene:
        """The scene that samples are drawn from."""
        try:
            return parse(tomli_w.dumps(self.scene), where="the data set's scene")
        except SceneError as error:
            raise DatasetError(f"this version cannot make the data set's scene: {error}") from error

    def split_of(self, index: int) -> str:
        """The split of a sample: by a hash of its index, so that neither seed nor count moves a sample."""
        digest = hashlib.sha256(f"sample {index}".encode()).digest()
        left = int.from_bytes(digest[:8], "big") / 2.0**64
        for name, share in self.splits.items():
            left -= share
            if left < 0.0:
                return name
        return next(reversed(self.splits))

    def require_same(self, other: "Plan", where: str) -> None:
        """`DatasetError` unless samples of the plan `other`, found at `where`, go on with this one's."""
        if self.scene != other.scene:
            keys = sorted(_differing(other.scene, self.scene))
            raise DatasetError(
                f"'{where}' holds a data set of another scene (they differ in {', '.join(keys[:5])}): "
                "use the same scene and settings to go on with it, or another folder"
            )
        for key in ("seed", "splits"):
            old, new = getattr(other, key), getattr(self, key)
            if old != new:
                raise DatasetError(
                    f"'{where}' holds a data set of {key} {old}, not {new}: use {old} to go on with it, "
                    "or another folder"
                )
        if self.count < other.count:
            raise DatasetError(
                f"'{where}' holds a data set of {other.count} samples, {self.count} were asked for: it can grow, "
                "not shrink; use another folder"
            )

    def require_maker(self, mine: dict[str, str]) -> None:
        """`DatasetError` where this machine would make other bytes than the one that began."""
        for name, version in self.made_with.items():
            if mine.get(name) != version:
                raise DatasetError(
                    f"the data set is made with {name} {version}, here is {mine.get(name) or 'none'}: samples would "
                    "differ in their last bits; use the same, or begin another data set"
                )


def _differing(old: Any, new: Any, at: str = "") -> list[str]:
    """Dotted keys in which two trees differ."""
    if isinstance(old, dict) and isinstance(new, dict):
        keys = old.keys() | new.keys()
        return [d for k in keys for d in _differing(old.get(k), new.get(k), f"{at}.{k}".strip("."))]
    if isinstance(old, list) and isinstance(new, list) and len(old) == len(new):
        pairs = enumerate(zip(old, new, strict=True))
        return [d for i, (a, b) in pairs for d in _differing(a, b, f"{at}.{i}")]
    return [] if old == new else [at]
