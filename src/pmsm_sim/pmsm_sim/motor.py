"""A motor file as the plant reads it."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, Field

from pwm_node import yaml_files

_MOST = 1e9  # of any quantity: infinity is none


class MotorPars(BaseModel):
    """
    Machine, mechanics and ratings (`config/motors/*.yaml`), SI units.

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
        Inertia of rotor and load (kg m^2).
    B : float
        Viscous friction (N m s).
    i_max : float
        Largest current the drive may ask for (A, amplitude).
    speed_max_rpm : float
        Largest mechanical speed (r/min).
    u_dc : float
        DC-link voltage it is meant for (V).
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    name: str
    description: str
    source: str
    R_s: float = Field(gt=0, le=_MOST)
    L_d: float = Field(gt=0, le=_MOST)
    L_q: float = Field(gt=0, le=_MOST)
    psi_f: float = Field(ge=0, le=_MOST)
    n_p: int = Field(ge=1, le=100)
    J: float = Field(gt=0, le=_MOST)
    B: float = Field(ge=0, le=_MOST, default=0.0)
    i_max: float = Field(gt=0, le=_MOST)
    speed_max_rpm: float = Field(gt=0, le=_MOST)
    u_dc: float = Field(gt=0, le=_MOST)


def load(name_or_path: str) -> MotorPars:
    """Motor of this name in `config/motors`, or of this file.

    Raises
    ------
    pwm_node.yaml_files.FileError
        If there is none, or its content is not a motor.
    """
    return yaml_files.load(yaml_files.find("motors", name_or_path), MotorPars)
