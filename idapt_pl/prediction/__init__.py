"""What a model with some effects predicts of measured recordings, and in which units it is wrong.

Recordings are cut into short windows (:mod:`~idapt_pl.prediction.data`), of which many are simulated at once
(:mod:`~idapt_pl.prediction.simulator`). What is left is told in units of the sensors' noise
(:mod:`~idapt_pl.prediction.whitening`), or of forces where noise is no yardstick
(:mod:`~idapt_pl.prediction.force_windows`).
"""
