"""A motor file as the controller reads it: the nominal values it may use."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, Field

from pwm_node import yaml_files

_MOST = 1e9  # of any quantity: infinity is none


class EstimatedPars(BaseModel):
    """
    What a data sheet tells the controller (`config/motors/*.yaml`), SI units.

    Keys that only the plant needs are passed over.

    Attributes
    ----------
    R_s : float
        Stator resistance (ohm).
    L_d, L_q : float
        d- and q-axis inductance (H).
    psi_f : float
        Permanent-magnet flux linkage (V s), amplitude-invariant.
    n_p : int
        Number of pole pairs.
    J : float
        Inertia (kg m^2), for the gains of the speed loop.
    i_max : float
        Largest current reference (A, amplitude).
    speed_max_rpm : float
        Largest speed reference (r/min).
    u_dc : float
        DC-link voltage it is meant for (V).
    """

    model_config = ConfigDict(extra="ignore", frozen=True)

    R_s: float = Field(gt=0, le=_MOST)
    L_d: float = Field(gt=0, le=_MOST)
    L_q: float = Field(gt=0, le=_MOST)
    psi_f: float = Field(gt=0, le=_MOST)  # the speed loop needs a torque per ampere
    n_p: int = Field(ge=1, le=100)
    J: float = Field(gt=0, le=_MOST)
    i_max: float = Field(gt=0, le=_MOST)
    speed_max_rpm: float = Field(gt=0, le=_MOST)
    u_dc: float = Field(gt=0, le=_MOST)


def load(name_or_path: str) -> EstimatedPars:
    """Nominal values of the motor of this name in `config/motors`, or of this file.

    Raises
    ------
    pwm_node.yaml_files.FileError
        If there is none, or its content is not a motor.
    """
    return yaml_files.load(yaml_files.find("motors", name_or_path), EstimatedPars)
