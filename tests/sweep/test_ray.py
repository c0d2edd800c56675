"""A sweep on a real Ray cluster of two nodes, one of them lost in the middle: nothing is lost, nothing run twice."""

import json
import os
import threading
import time

import pytest
import yaml
from conftest import tiny_config

from cli.main import main

pytestmark = [pytest.mark.slow]
ray = pytest.importorskip("ray", reason="pip install -e '.[ray]'")

PATIENT = {
    "RAY_USAGE_STATS_ENABLED": "0",
    "RAY_raylet_start_wait_time_s": "500",
    "RAY_gcs_server_request_timeout_seconds": "120",
    "RAY_gcs_rpc_server_connect_timeout_s": "60",
    "RAY_worker_register_timeout_seconds": "300",
    "RAY_health_check_initial_delay_ms": "60000",
    "RAY_health_check_timeout_ms": "60000",
    "RAY_health_check_failure_threshold": "20",
}
"""Nodes may take minutes to start on a machine that others use."""
NODE = {"num_cpus": 1, "object_store_memory": 100 * 2**20}


@pytest.fixture
def cluster(monkeypatch):
    for key, value in PATIENT.items():
        monkeypatch.setenv(key, value)
    from ray.cluster_utils import Cluster

    made = Cluster(initialize_head=True, head_node_args=NODE | {"include_dashboard": False})
    yield made
    ray.shutdown()
    made.shutdown()


@pytest.fixture
def sweep_yaml(tmp_path):
    config = tiny_config()
    config.pop("seed")
    (tmp_path / "tiny.yaml").write_text(yaml.safe_dump(config))
    path = tmp_path / "sweep.yaml"

    def make(**more):
        said = {"folder": str(tmp_path / "sweep"), "tasks": {"pendulum": ["configs/pendulum_quick.yaml",
                str(tmp_path / "tiny.yaml")]}, "targets": ["hard"], "seeds": [0, 1]}  # fmt: skip
        path.write_text(yaml.safe_dump(said | more))
        return path

    return make


def finished_files(folder):
    """When each finished stage and recording was written."""
    found = [*folder.glob("runs/*/step_*/*/final.ckpt"), *folder.glob("runs/*/step_*/*.h5")]
    return {path: path.stat().st_mtime_ns for path in found}


def without_times(summary):
    return {k: v for k, v in json.loads(summary.read_text()).items() if k not in ("wall_s", "stages", "checksum")}


@pytest.mark.parametrize("storage", [False, True], ids=["shared folder", "storage"])
def test_the_runs_of_a_lost_node_go_on_elsewhere(storage, cluster, sweep_yaml, tmp_path, capsys):
    node, seen = cluster.add_node(**NODE), {}
    where = tmp_path / ("storage" if storage else "sweep")

    def lose_a_node():
        until = time.monotonic() + 900
        while time.monotonic() < until and len(list(where.glob("runs/*/step_00/visual/final.ckpt"))) < 2:
            time.sleep(0.2)
        seen.update(finished_files(where))
        cluster.remove_node(node, allow_graceful=False)

    loser = threading.Thread(target=lose_a_node, daemon=True)
    loser.start()
    path = sweep_yaml(**({"storage": str(where)} if storage else {}))
    assert main(["sweep", "--config", str(path), "--address", cluster.address]) == 0, capsys.readouterr().err
    loser.join()
    assert len([p for p in seen if "visual" in str(p)]) == 2, "both were in the middle"
    now = finished_files(where)
    assert all(now[p] == written for p, written in seen.items()), "what was finished was not done again"
    sweep = tmp_path / "sweep"
    tries = {p.stem: (sweep / f"logs/{p.stem}.log").read_text() for p in sweep.glob("status/*.json")}
    statuses = [json.loads(p.read_text()) for p in sweep.glob("status/*.json")]
    assert [s["state"] for s in statuses] == ["done"] * 2 and all(s["failures"] == [] for s in statuses), tries
    for name in tries:
        assert main(["ledger", "--run", str(sweep / "runs" / name)]) == 0, "no target interaction is counted twice"
    if not storage:
        whole = tmp_path / "whole"
        alone = ["--threads=1", "--side_by_side=false", "--render_processes=0", f"--run_dir={whole}"]
        assert main(["fit", "--config", str(sweep / "configs/pendulum_hard_IDAPT_0.yaml"), *alone]) == 0
        killed = without_times(sweep / "runs/pendulum_hard_IDAPT_0/summary.json")
        assert killed == without_times(whole / "summary.json"), "as a run that nobody disturbed"


def test_a_node_without_the_package_is_named_before_anything_runs(cluster, sweep_yaml, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)  # Ray has its tasks look for modules in the folder that a sweep is started from
    (tmp_path / "broken/idapt_pl").mkdir(parents=True)
    (tmp_path / "broken/idapt_pl/__init__.py").write_text("raise ImportError('there is no package here')\n")
    path = os.pathsep.join((str(tmp_path / "broken"), *filter(None, [os.environ.get("PYTHONPATH")])))
    cluster.add_node(**NODE, env_vars={"PYTHONPATH": path})
    assert main(["sweep", "--config", str(sweep_yaml()), "--address", cluster.address]) == 1
    said = capsys.readouterr().err
    assert "cannot run idapt" in said and "there is no package here" in said and "Traceback" not in said
    assert not list((tmp_path / "sweep").glob("runs/*"))
