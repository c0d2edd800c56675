"""dm_control's cart-pole, switched off when the pole leans too far, as one would do with a real one."""

from idapt_pl.tasks.dm_control_task import DMControlTask

TOO_FAR = 0.2
"""As in Gymnasium's, rad."""


class StoppedCartPole(DMControlTask):
    """As `dm_control:cartpole/balance`, with that end, four steps of 0.01 s for an action, and a reward for each."""

    def __init__(self, **options):
        super().__init__("cartpole/balance", **{"action_repeat": 4} | options)

    def outcome(self, model, data, action):
        over = abs(float(data.qpos[1])) > TOO_FAR
        return float(not over), over
