"""Joints that are driven through a tendon are driven: a table on two slides is no floating base."""

import mujoco
import pytest

from idapt_pl.effects.base import ACTUATED, find_joints
from idapt_pl.effects.candidate import actuated_dofs, floating_base_dofs, joints_with_motor
from idapt_pl.effects.driven import joints_of_actuators, names_of_joints_of_actuators

TABLE = """
<mujoco>
  <worldbody>
    <body name="table"><joint name="x" type="slide" axis="1 0 0"/><joint name="y" type="slide" axis="0 1 0"/>
      <geom size="0.1" mass="1"/>
      <body name="mast"><joint name="passive" axis="0 1 0"/><geom size="0.05" mass="0.2"/></body></body>
  </worldbody>
  <tendon>
    <fixed name="along x"><joint joint="x" coef="1"/><joint joint="y" coef="0"/></fixed>
    <fixed name="along y"><joint joint="x" coef="0"/><joint joint="y" coef="2"/></fixed>
  </tendon>
  <actuator><motor tendon="along x"/>{also}</actuator>
</mujoco>"""


@pytest.mark.parametrize(
    ("also", "names"),
    [("", {"x"}), ('<motor tendon="along y"/>', {"x", "y"}), ('<motor jointinparent="passive"/>', {"x", "passive"})],
)
def test_joints_on_a_fixed_tendon_with_an_actuator_are_driven(also, names):
    spec = mujoco.MjSpec.from_string(TABLE.format(also=also))
    model = spec.copy().compile()
    assert {model.joint(j).name for j in joints_of_actuators(model)} == names == names_of_joints_of_actuators(spec)
    assert {j.name for j in find_joints(spec, ACTUATED)} == names
    assert {model.joint(int(model.dof_jntid[v])).name for v in actuated_dofs(model)} == names


def test_slides_that_are_driven_through_tendons_are_part_of_the_machine():
    model = mujoco.MjModel.from_xml_string(TABLE.format(also='<motor tendon="along y"/>'))
    assert not floating_base_dofs(model)
    assert [name for _, _, name in joints_with_motor(model)] == ["x", "y"]
    free = mujoco.MjModel.from_xml_string(TABLE.format(also="").replace('tendon="along x"', 'joint="passive"'))
    assert floating_base_dofs(free) == {0, 1}
