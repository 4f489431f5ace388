"""Which file of a folder is which layer: by X2 attributes, else by the naming rules of CAD tools."""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Literal

from scenes.support.errors import FileError

Role = Literal["paste", "mask", "copper", "outline", "legend"]
ROLES: tuple[Role, ...] = ("paste", "mask", "copper", "outline", "legend")
Side = Literal["top", "bottom"]

_KINDS: dict[str, Role] = {
    "paste": "paste",
    "soldermask": "mask",
    "copper": "copper",
    "profile": "outline",
    "legend": "legend",
}


def layer_files(folder: Path, side: Side, given: Mapping[Role, Path]) -> dict[Role, Path]:
    """Layers of one side ("top" or "bottom") of a board in a folder of Gerber files: role -> file, absent ones left
    out.

    A layer is recognised by its X2 attribute ``.FileFunction``, else by its name: by the rules of the gerbonara library
    (the optional extra ``board``), those of the CAD tool that fits most layers. Files that are `given` win. Raises
    `FileError` when the folder is missing or has no paste layer of that side.
    """
    if not folder.is_dir():
        raise FileError(
            f"board folder '{folder}' does not exist: give the folder of the Gerber files"
        )
    files = sorted(path for path in folder.iterdir() if path.is_file())
    found: dict[Role, Path] = {}
    for path in files:
        role = _declared(path, side)
        if role:
            found.setdefault(role, path)
    hint = ""
    if len(found) < len(ROLES):
        named = _named(files, side)
        if named is None:
            hint = ', or find layers by their names: pip install "fringebench[board]"'
        found = (named or {}) | found
    found |= given
    if "paste" not in found:
        raise FileError(
            f"no {side} paste layer among the {len(files)} files of '{folder}': name it under [board.files] "
            f"paste = ...{hint}"
        )
    return found


def _declared(path: Path, side: Side) -> Role | None:
    """A layer's role by its TF.FileFunction attribute, plain or in a comment."""
    try:
        head = path.read_bytes()[:8192].decode("latin-1")
    except OSError as error:
        raise FileError(f"'{path}' cannot be read: {error}") from error
    match = re.search(r"TF\.FileFunction,([^*\n]*)", head)
    if not match:
        return None
    kind, *rest = (part.strip().lower() for part in match[1].split(","))
    role = _KINDS.get(kind)
    # X2 writes "Bot"; "bottom" is written too.
    if role == "outline" or {side, side[:3]} & set(rest):
        return role
    return None


def _named(files: Sequence[Path], side: Side) -> dict[Role, Path] | None:
    """Roles by the naming rules of the CAD tool that fits most layers; None without the library."""
    try:
        from gerbonara.layer_rules import MATCH_RULES
    except ImportError:
        return None
    names = {
        "paste": f"{side} paste",
        "mask": f"{side} mask",
        "copper": f"{side} copper",
        "outline": "mechanical outline",
        "legend": f"{side} silk",
    }
    best: dict[Role, Path] = {}
    for rules in MATCH_RULES.values():
        found: dict[Role, Path] = {}
        for role in ROLES:
            rule = rules.get(names[role])
            fits = [p for p in files if rule and re.fullmatch(rule, p.name, re.IGNORECASE)]
            if fits:
                found[role] = fits[0]
        if len(found) > len(best):
            best = found
    return best
