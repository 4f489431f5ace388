"""Coverage-guided fuzzing of one reader, started by hand; what it finds becomes a test in `test_damaged_files.py`.

Needs atheris (``pip install atheris``; Linux, CPython up to 3.13)::

    python -m tests.faults.fuzz_readers gerber -max_total_time=300

The first word is a target of `targets.py`, the rest are libFuzzer's options; ``-max_total_time`` is in seconds. Only a
`FringebenchError` may escape a reader: anything else stops the run and leaves the input as ``crash-*`` in the current
folder. A hang counts too (``-timeout=60``), and so does memory (``-rss_limit_mb=4096``).
"""

import contextlib
import ctypes
import os
import sys
import tempfile
import warnings
from pathlib import Path

import atheris  # type: ignore[import-untyped,unused-ignore]

with atheris.instrument_imports(
    include=["scenes", "render", "decode", "fringebench", "gerbonara", "tomllib", "json"]
):
    import gerbonara  # noqa: F401  imported here to be instrumented

    from scenes.support.errors import FringebenchError
    from tests.faults.damage import damage_with_seed
    from tests.faults.targets import TARGETS


def main() -> None:
    """Fuzz the target named first until libFuzzer's options say stop."""
    name = sys.argv.pop(1)
    target = TARGETS[name]
    warnings.simplefilter("error")
    with tempfile.TemporaryDirectory() as folder:
        corpus = Path(folder) / "corpus"
        corpus.mkdir()
        for i, whole in enumerate(target.seeds()):
            (corpus / f"{i}").write_bytes(whole)
        path = Path(folder) / f"input{target.suffix}"

        def one(data: bytes) -> None:
            path.write_bytes(data)
            with contextlib.suppress(FringebenchError):
                target.read(path)

        def mutated(data: bytes, limit: int, seed: int) -> bytes:
            if seed % 2:
                return damage_with_seed(data, seed)[:limit]
            return bytes(atheris.Mutate(data, limit))

        # Threads of Dr.Jit still run when libFuzzer exits, which would look like a crash.
        leave = ctypes.CFUNCTYPE(None, ctypes.c_int, ctypes.c_void_p)(
            lambda status, _: os._exit(status)
        )
        ctypes.CDLL(None).on_exit(leave, None)
        defaults = ["-timeout=60", "-rss_limit_mb=4096", "-max_len=20000"]
        atheris.Setup(
            [sys.argv[0], *defaults, *sys.argv[1:], str(corpus)], one, custom_mutator=mutated
        )
        atheris.Fuzz()


if __name__ == "__main__":
    main()
