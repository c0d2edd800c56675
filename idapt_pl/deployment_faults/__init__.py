"""Deployment faults: what is wrong with a recording, or with how a robot was wired, before physics is blamed.

:func:`find_deployment_faults` is the way in; a :class:`~idapt_pl.deployment_faults.mend.Mend` is what is to be done to
a recording, a :class:`~idapt_pl.deployment_faults.fault.FaultReport` what comes out.
"""

from idapt_pl.deployment_faults.fault import DeploymentFault, FaultKind, FaultReport
from idapt_pl.deployment_faults.find import find_deployment_faults

__all__ = ["DeploymentFault", "FaultKind", "FaultReport", "find_deployment_faults"]
