"""The verb `dataset`: a data set with its page in one call."""

from collections.abc import Callable, Mapping
from pathlib import Path

from fringebench.datasets.building import Built, build
from fringebench.datasets.dataset_plan import DatasetPlan
from scenes import Scene, load


def dataset(
    scene: Scene | str,
    folder: str | Path,
    count: int,
    seed: int = 0,
    splits: Mapping[str, float] | None = None,
    picture: bool = True,
    heights: bool = False,
    variants: int = 1,
    ring_light: bool = False,
    workers: int = 1,
    scheduler: str | None = None,
    strict: bool = False,
    progress: Callable[[int, int, int], None] | None = None,
    modulation: bool = False,
    height_tiff: bool = False,
) -> Built:
    """Make a data set of random samples of a scene, or continue one that was interrupted.

    Sample i depends on `seed` and i alone: the same arguments give the same bytes, whatever the number of workers. Values
    that the scene's ``randomise`` table describes are drawn independently for each sample. Read the result with `Dataset`.

    Parameters
    ----------
    scene
        A scene, the name of a shipped scene, or the path of a scene's TOML file.
    folder
        Output folder, or any URL that fsspec opens.
    count
        Number of samples; may be larger when the data set is continued.
    seed
        Seed of the whole data set, 0 or more.
    splits
        Share of each split, summing to 1; by default train 0.8, val 0.1, test 0.1.
    picture
        Give each sample ``picture.png``, the 8-bit picture that a 2-D camera sees; COCO labels refer to it.
    heights
        Give each sample its measured heights: ``height.png`` (16 bits) and ``reconstruction.exr``.
    variants
        Samples that share one light: only noise, and what is drawn for sensor and exposures, differ.
    ring_light
        Give each sample ``colour.png``, a 2-D camera's colour picture under red, green and blue ring lights.
    workers
        Processes of one core each.
    scheduler
        Address of a Dask scheduler to use instead of local processes.
    strict
        Stop at the first sample that cannot be made; by default it is recorded with its reason.
    progress
        Called with the samples done, the samples failed, and `count`.
    modulation
        Give each sample ``modulation.png``, the measured fringe amplitude in 16 bits.
    height_tiff
        Give each sample ``height.tiff``, the measured heights in mm as float32, NaN where there is none.

    Returns
    -------
    Built
        The plan, the record of every sample, and how many were made by this call.

    Raises
    ------
    DatasetError
        If `folder` holds another data set or cannot be written, or no sample could be made.

    Examples
    --------
    >>> import tempfile, fringebench as fb
    >>> scene = fb.load("step", {"camera.resolution": [64, 48], "sampling.samples": 4})
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     made = fb.dataset(scene, folder, count=2)
    ...     fb.Dataset(folder)[1].stack.resolution
    (64, 48)
    >>> made.made
    2
    """
    from fringebench.datasets.overview_page import write_report

    shares = None if splits is None else dict(splits)
    loaded = load(scene) if isinstance(scene, str) else scene
    plan = DatasetPlan.of(
        loaded,
        count,
        seed,
        shares,
        picture=picture,
        heights=heights,
        variants=variants,
        ring_light=ring_light,
        modulation=modulation,
        height_tiff=height_tiff,
    )
    built = build(plan, folder, workers, scheduler, strict, progress)
    write_report(str(folder))
    return built
