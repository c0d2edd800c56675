"""Parts of a planar runner's state by name."""

from benchmarks.misread import group

PARTS = ("height", "pitch", "speed", "angles", "rates")


def test_the_parts_of_a_planar_runner_are_its_state_each_component_once():
    """z, pitch, six joints; then dx/dt, dz/dt, and the rates of pitch and joints."""
    assert sorted(i for part in PARTS for i in group(part, 17)) == group("all", 17) == [*range(17)]
    assert (group("height", 17), group("speed", 17), group("none", 17)) == ([0, 9], [8], [])


def test_components_can_be_given_by_number():
    assert group("3,0", 17) == [3, 0]
