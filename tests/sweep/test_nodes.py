"""The machines of a cluster are looked at before anything runs; what is wrong with one is said in a sentence."""

import importlib.metadata
import socket
import subprocess
import sys

import pytest

from idapt_pl.sweep.nodes import SeenNode, check_nodes, fits, probing, reachable
from idapt_pl.sweep.ray_runner import connect
from idapt_pl.sweep.settings import RunResources

VERSION = importlib.metadata.version("idapt")


def node(**changes):
    return SeenNode(**{"name": "10.0.0.2", "cpus": 4.0, "gpus": 0.0, "version": VERSION} | changes)


def test_runs_go_side_by_side_on_all_machines():
    assert check_nodes([node(), node(cpus=7.0)], RunResources(2), "/sweep") == 2 + 3
    assert fits(node(gpus=1.0), RunResources(1, 0.5)) == 2 and fits(node(), RunResources(1, 1)) == 0


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"version": "", "error": "No module named 'idapt_pl'"}, ["10.0.0.2", "No module named", "install"]),
        ({"version": "0.0.1"}, ["idapt 0.0.1", f"here it is {VERSION}"]),
        ({"sees": False}, ["/sweep", "storage"]),
    ],
)  # fmt: skip
def test_a_machine_that_cannot_carry_out_runs_is_named(changes, words):
    with pytest.raises(ValueError) as error:
        check_nodes([node(), node(**changes)], RunResources(), "/sweep")
    assert all(word in str(error.value) for word in words)


def test_runs_that_no_machine_is_large_enough_for_are_refused():
    with pytest.raises(ValueError, match=r"takes 8 cpus and 0 gpus \(resources\), but no node has as many: 4 cpus"):
        check_nodes([node()], RunResources(8), "/sweep")


WITHOUT_THE_PACKAGE = """
import pickle, sys
class Nowhere:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in ("idapt_pl", "cli"):
            raise ModuleNotFoundError(f"No module named {name!r}")
sys.meta_path.insert(0, Nowhere())
print(pickle.loads(sys.stdin.buffer.read())(None))
"""


def test_the_question_asked_of_a_machine_needs_nothing_there(tmp_path):
    cloudpickle = pytest.importorskip("ray.cloudpickle")
    assert probing()(str(tmp_path / "none")) == {"sees": False, "version": VERSION}
    asked = cloudpickle.dumps(probing())
    done = subprocess.run([sys.executable, "-c", WITHOUT_THE_PACKAGE], input=asked, capture_output=True)
    answer = done.stdout.decode()
    assert done.returncode == 0 and "No module named 'idapt_pl'" in answer and "version" not in answer, done.stderr


def free_port():
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        return s.getsockname()[1]


@pytest.mark.parametrize("scheme", ["", "ray://"])
def test_a_cluster_that_is_not_there_is_said_at_once(scheme):
    address = f"{scheme}127.0.0.1:{free_port()}"
    with pytest.raises(ValueError, match=f"--address {address}: no Ray cluster there .*ray start --head"):
        connect(None, address)


@pytest.mark.parametrize("address", ["magic", "host:", ":80", "host:port"])
def test_addresses_that_are_none(address):
    with pytest.raises(ValueError, match="expected auto, local, HOST:PORT"):
        reachable(address)
