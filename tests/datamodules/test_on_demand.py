"""What takes seconds to load is loaded by those who use it, and prepared then."""

import subprocess
import sys

import pytest

from datamodules.on_demand import on_demand


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
        "import torch; assert torch.tensor([1e-40]).mul(1).item() == 0, 'denormals are flushed'\n"
        "print(logging.getLogger('lightning.pytorch').level == logging.WARNING)\n"
    )
    assert printed(program) == "True\n"


def test_a_name_that_a_package_does_not_have_is_an_error():
    with pytest.raises(AttributeError, match="'datamodules' has no attribute 'nothing'"):
        on_demand("datamodules", {"trajectories": "Episode"})("nothing")
