"""The LightningModules: one for each thing that is learned."""

from idapt_pl.modules.dynamics import ActionTransformation
from idapt_pl.modules.filter_training import FilterTraining
from idapt_pl.modules.imitation import Imitation
from idapt_pl.modules.policy import AsymmetricSAC
from idapt_pl.modules.recurrent_policy import RecurrentSAC
from idapt_pl.modules.sac import SAC
from idapt_pl.modules.state_policy import StateSAC
from idapt_pl.modules.state_predictor import StatePredictor
from idapt_pl.modules.visual import VisualTransformation

__all__ = [
    "SAC",
    "ActionTransformation",
    "AsymmetricSAC",
    "FilterTraining",
    "Imitation",
    "RecurrentSAC",
    "StatePredictor",
    "StateSAC",
    "VisualTransformation",
]
