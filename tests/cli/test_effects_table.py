"""The table of effects can be read in a terminal of 80 columns: words wrap between words, numbers not at all."""

import io

import mujoco
from rich.console import Console

from cli.diagnose import effects_tables
from idapt_pl.diagnosis.answer.result import EffectEstimate, ParameterEstimate

XML = """<mujoco><worldbody><body name="b"><joint name="left_shoulder_lift_joint"/><geom size="0.1"/></body></worldbody>
</mujoco>"""


def test_names_and_numbers_stay_whole_in_80_columns():
    value = ParameterEstimate(0.04, 0.300247, (0.299485, 0.301009), "N·m or N")
    how = ParameterEstimate("euler", "implicitfast", None, "")
    effects = [
        EffectEstimate("joint_frictionloss", "left_shoulder_lift_joint", {"frictionloss": value}, probability=0.93),
        EffectEstimate("numerics", "world", {"integrator": how}),
    ]
    (table,) = effects_tables(effects, mujoco.MjModel.from_xml_string(XML))
    file = io.StringIO()
    Console(file=file, width=80).print(table)
    said = file.getvalue()
    for whole in (
        "0.3002 N·m",
        "0.2995 to 0.3010",
        "0.04",
        "93%",
        "left_shoulder_lift_joint",
        "integrator",
        "implicitfast",
    ):
        assert whole in said
