"""The architecture page names every folder of every room."""

import pytest

from tests.commands import ROOMS, ROOT

PAGE = (ROOT / "docs" / "architecture.md").read_text("utf-8")


@pytest.mark.parametrize("room", ROOMS)
def test_architecture_page_names_every_folder(room: str) -> None:
    section = PAGE.partition(f"\n## {room}\n")[2].partition("\n## ")[0]
    folders = [path.parent for path in (ROOT / room).glob("*/__init__.py")]
    missing = [path.name for path in folders if f"`{path.name}/`" not in section]
    assert not missing
