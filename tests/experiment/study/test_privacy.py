"""Who else can read what participants gave: modes of files and folders, as unzipping or a file system leaves them."""

import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from palpate.experiment import storage
from palpate.experiment.study import privacy


@pytest.fixture
def shared() -> Iterator[Path]:
    """A dataset in a folder that everybody may enter."""
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder) / "study"
        storage.people_folder(root)
        Path(folder).chmod(0o755)
        root.chmod(0o755)
        for path in (storage.seed_path(root), storage.roster_path(root)):
            path.write_bytes(b"")
            path.chmod(0o644)
        yield root


def test_what_others_can_read_of_people_seed_and_roster_is_named(shared: Path) -> None:
    source = shared / "sourcedata"
    assert privacy.readable_by_others(shared) == ()
    assert privacy.readers_warning(shared) == ""
    # As an unzip leaves it, or a file system without modes.
    source.chmod(0o755)
    files = (storage.seed_path(shared), storage.roster_path(shared))
    assert privacy.readable_by_others(shared) == (source, *files)
    files[0].chmod(0o600)
    assert privacy.readable_by_others(shared) == (source, files[1])
    # Whoever knows a name may still read it.
    source.chmod(0o711)
    assert privacy.readable_by_others(shared) == (files[1],)
    shared.chmod(0o700)
    assert privacy.readable_by_others(shared) == ()
    shared.chmod(0o755)
    source.chmod(0o750)
    assert privacy.readable_by_others(shared) == (source, files[1])
    # A group that may write shares the files.
    source.chmod(0o770)
    files[1].chmod(0o660)
    assert privacy.readable_by_others(shared) == ()
    assert str(files[1]) not in privacy.readers_warning(shared)
