"""The look of the hard manipulation domains; the paper draws them with another engine, Unity3D, in a room."""

from __future__ import annotations

from idapt_pl.effects.base import Effect
from idapt_pl.effects.visual import Light, Material, Renderer, Scenery


def indoors(robot: tuple[float, float, float], other_lamps: tuple[str, ...] = ()) -> tuple[Effect, ...]:
    """A room, a wooden table, daylight from a window on the right and a dim warm lamp overhead.

    Args:
        robot: where the robot stands, facing +x [m].
        other_lamps: names of the model's further lamps, which are put out.
    """
    x, y, z = robot
    daylight: dict = {"diffuse": (0.62, 0.6, 0.55), "ambient": (0.1, 0.1, 0.1), "specular": (0.2, 0.2, 0.2)}
    return (
        Renderer("world", engine="filament"),
        Scenery("world", "interior", position=robot),
        Material("table", picture="wood2.png"),
        Light("lamp", **daylight, direction=(0.1, 0.6, -0.8), kind="directional"),
        Light("overhead", (0.3, 0.22, 0.12), (0, 0, 0), (0.1, 0.1, 0.1), position=(x + 0.5, y, z + 2.6)),
        Light("headlight", (0.15, 0.15, 0.15), (0.25, 0.25, 0.25), (0, 0, 0)),
        *(Light(name, (0, 0, 0), (0, 0, 0), (0, 0, 0)) for name in other_lamps),
    )
