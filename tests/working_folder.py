"""A working folder in which a laboratory's own files have names that palpate, its libraries or Python use."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

LOG = "PALPATE_TEST_IMPORTED"
"""The environment's variable that names the file into which the laboratory's files say that they were imported."""

MODULES = ("analysis", "cobs", "experiment", "numpy", "palpate", "queue", "random", "select", "threading")
PACKAGES = ("analysis", "experiment", "palpate")

SOURCE = f"""\
import os
with open(os.environ["{LOG}"], "a") as log:
    log.write(__file__ + "\\n")
raise RuntimeError("imported: " + __file__)
"""


class WorkingFolder:
    """Such a folder; nothing of it is `imported` as long as all is well."""

    def __init__(self, folder: Path, modules: tuple[str, ...] = MODULES, packages: tuple[str, ...] = PACKAGES) -> None:
        """Put the files into a folder, which may be there already."""
        folder.mkdir(exist_ok=True)
        self.path, self.log = folder, folder / "imported.log"
        self.environment = {**os.environ, LOG: str(self.log)}
        self.environment.pop("PYTHONSAFEPATH", None)
        for name in packages:
            (folder / name).mkdir()
        for place in (*modules, *(f"{name}/__init__" for name in packages)):
            (folder / f"{place}.py").write_text(SOURCE, "utf-8")

    @property
    def imported(self) -> list[str]:
        """The files that were imported from the folder, each as often as it was."""
        return self.log.read_text("utf-8").splitlines() if self.log.exists() else []

    def run(self, *command: object) -> subprocess.CompletedProcess[str]:
        """Return how a command of Python's folder of programs ended, which is given in the folder."""
        program, *arguments = map(str, command)
        return subprocess.run(
            [Path(sys.executable).with_name(program), *arguments],
            cwd=self.path,
            env=self.environment,
            capture_output=True,
            text=True,
            check=False,
            timeout=120,
        )
