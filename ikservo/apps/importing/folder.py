"""Load drafts of arms, and write all files of their folders together."""

from __future__ import annotations

import re
import tempfile
from collections.abc import Sequence
from pathlib import Path

from ikservo.apps.importing.draft import ArmDraft
from ikservo.errors import BadValueError, FileFormatError, InputError
from ikservo.files.writing import write_all_atomic, write_atomic
from ikservo.model import Model, arm_names, load_model

_NAME = re.compile(r"[A-Za-z0-9_-]{1,64}")


def check_name(name: str) -> None:
    """Refuse a name that an arm may not have.

    Raises:
        BadValueError: The name contains a forbidden character, or an arm of ikservo already has it.
    """
    if not _NAME.fullmatch(name):
        raise BadValueError("The name", name, "1 to 64 of the characters A-Z a-z 0-9 _ -")
    if name in arm_names():
        raise BadValueError(
            "The name", name, "a new name, because an arm with this name ships with ikservo"
        )


def check_new(names: Sequence[str], folder: Path, *, overwrite: bool) -> None:
    """Refuse arm names for which a folder already exists.

    Raises:
        InputError: A folder exists and may not be overwritten.
    """
    for name in names:
        if (folder / name).exists() and not overwrite:
            raise InputError(f"{folder / name} already exists.", "Replace its files: --overwrite.")


def load_draft(draft: ArmDraft, folder: Path | None = None) -> Model:
    """Write a draft to a folder (by default a temporary one), without meshes, and load the arm.

    Raises:
        FileFormatError: The draft cannot be loaded; the message names its source description.
    """
    if folder is None:
        with tempfile.TemporaryDirectory() as name:
            return load_draft(draft, Path(name))
    for name, content in draft.files().items():
        if name in ("arm.toml", "arm.urdf"):
            write_atomic(folder / name, content)
    try:
        return load_model(folder)
    except FileFormatError as error:  # name the description, not the temporary file
        where = f"{error.path.name} of the new arm, {error.where}".rstrip(", ")
        raise FileFormatError(draft.source, where, error.found, error.expected) from error


def write_drafts(drafts: Sequence[ArmDraft], folder: Path) -> list[Path]:
    """Write the files of all arms, or none; return the arms' folders.

    Raises:
        FileWriteError: The disk is full, read-only or broken; the message names the file.
    """
    files = {
        folder / draft.name / name: content
        for draft in drafts
        for name, content in draft.files().items()
    }
    write_all_atomic(files)
    return [folder / draft.name for draft in drafts]
