"""Simulated studies on a real Dask cluster: scheduler and two worker processes, on loopback."""

from __future__ import annotations

from collections.abc import Iterator
from types import SimpleNamespace

import pytest

from palpate.analysis.power import simulate
from palpate.experiment.errors import PowerError
from palpate.experiment.protocol.files import shipped
from tests.conftest import Palpate
from tests.working_folder import LOG, WorkingFolder

dask, distributed = pytest.importorskip("dask"), pytest.importorskip("distributed")


@pytest.fixture(scope="module")
def address(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """The cluster's address; it began as the guide says, in a folder that it imports nothing of."""
    folder = WorkingFolder(tmp_path_factory.mktemp("lab"))
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder.path)
        patch.setenv(LOG, str(folder.log))
        patch.setenv("PYTHONSAFEPATH", "1")
        # A task that ends its worker is given up at once, and not after it has ended three more.
        with dask.config.set({"distributed.scheduler.allowed-failures": 0}):
            cluster = distributed.LocalCluster(
                n_workers=2, threads_per_worker=1, host="127.0.0.1", dashboard_address=None
            )
    with cluster:
        yield cluster.scheduler_address
    assert folder.imported == []


def test_the_cluster_gives_the_bytes_that_one_core_gives(palpate: Palpate, address: str) -> None:
    asked = ("power", shipped("okamoto2012.toml"), "--participants", "3,5", "--studies", "1500", "--json")
    here = palpate(*asked, "--jobs", "1")
    assert here[0] == 0
    assert palpate(*asked, "--scheduler", address) == here


def test_every_result_comes_with_its_place(address: str) -> None:
    assert dict(simulate.on_cluster(abs, [-3, -2, -1, 0], address)) == {0: 3, 1: 2, 2: 1, 3: 0}


def test_workers_with_other_software_are_refused(address: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(simulate, "metadata", SimpleNamespace(version=lambda _: "0"))
    with pytest.raises(PowerError, match=r"allowed: .*'numpy': '0'.*so that results are the same"):
        list(simulate.on_cluster(abs, [1], address))


def test_a_worker_without_the_software_is_refused(address: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(simulate, "software", lambda: {"no-such-package": "1"})
    with pytest.raises(PowerError, match=r"got \{'no-such-package': 'none'\}; allowed: .*install the same versions"):
        list(simulate.on_cluster(abs, [1], address))


def test_a_worker_that_dies_is_an_error_in_a_line(address: str) -> None:
    with pytest.raises(PowerError, match=r"lost the cluster .*try again"):
        list(simulate.on_cluster(_die, [1], address))


def _die(_: int) -> None:
    import os

    os._exit(1)
