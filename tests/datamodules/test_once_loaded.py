"""What takes seconds to load is loaded by those who use it, and prepared then."""

import subprocess
import sys

import pytest

from datamodules.once_loaded import on_demand, once_loaded


def printed(program):
    """What a fresh process prints."""
    return subprocess.run(
        [sys.executable, "-W", "ignore", "-c", program], capture_output=True, text=True, check=True
    ).stdout


@pytest.mark.parametrize("command", ["import_", "diagnose", "excite"])
def test_commands_that_train_nothing_start_without_torch(command):
    assert (
        printed(f"import sys, idapt_pl, cli.{command}; print(sorted({{'torch', 'lightning'}} & {{*sys.modules}}))")
        == "[]\n"
    )


def test_what_is_loaded_later_is_prepared_all_the_same():
    program = (
        "import sys, logging, idapt_pl; from cli.main import main\n"
        "try: main(['import'])\n"
        "except SystemExit: pass\n"
        "assert 'torch' not in sys.modules\n"
        "from datamodules import *\n"
        "assert 'torchvision' in sys.modules and UnpairedImages.__module__ == 'datamodules.unpaired'\n"
        "print(logging.getLogger('lightning.pytorch').level == logging.WARNING)\n"
    )
    assert printed(program) == "True\n"


def test_what_waits_for_a_module_is_done_once_it_is_there_and_in_order(tmp_path, monkeypatch):
    (tmp_path / "waited_for.py").write_text("done = []")
    monkeypatch.syspath_prepend(tmp_path)

    def note(what):
        return lambda: sys.modules["waited_for"].done.append(what)

    once_loaded("waited_for", note(1))
    once_loaded("waited_for", note(2))
    import waited_for

    assert waited_for.done == [1, 2]
    once_loaded("waited_for", note(3))
    assert waited_for.done == [1, 2, 3]


def test_a_name_that_a_package_does_not_have_is_an_error():
    with pytest.raises(AttributeError, match="'datamodules' has no attribute 'nothing'"):
        on_demand("datamodules", {"trajectories": "Episode"})("nothing")
