"""The next recording: the motion that best tells the remaining explanations of a diagnosis apart.

:func:`~idapt_pl.excitation.plan.design_motion` is the way in.
"""
