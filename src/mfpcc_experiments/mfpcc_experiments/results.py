"""The interface for scripts and notebooks: an experiment, or a recording, as one object.

``from mfpcc_experiments import run, load`` needs ``source setup.bash`` and no running ROS.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import ExitStack
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from mfpcc_experiments.bags import Recording
from mfpcc_experiments.bags import recording as bags
from mfpcc_experiments.files import result_folder
from mfpcc_experiments.measuring import metrics, window
from mfpcc_experiments.measuring.columns import columns
from mfpcc_experiments.progress import progress_bar
from mfpcc_experiments.running import ENGINES, Scenario, scenario
from mfpcc_experiments.running import run as running
from mfpcc_experiments.scratch import scratch
from pwm_node.errors import ForPeople
from pwm_node.names import unknown
from pwm_node.parameters import ParameterError

if TYPE_CHECKING:
    import pandas

Array = NDArray[np.float64]


class MissingPackageError(ForPeople):
    """Something asked for needs a package that is not installed."""


class Result:
    """
    One run, as numbers and arrays.

    All arrays have one row per recorded PWM period, n in all; what was not recorded in a period is
    NaN. Times are the starts of the periods.

    Parameters
    ----------
    recording : Recording
        What was recorded.

    Attributes
    ----------
    recording : Recording
        The messages themselves, topic by topic, as structured arrays.
    """

    def __init__(self, recording: Recording) -> None:
        self.recording = recording

    def __repr__(self) -> str:
        config = self.recording.config
        what = " ".join(str(config[key]) for key in ("experiment", "scheme") if config.get(key))
        return f"<Result {what or self.recording.path.name}: {len(self.time)} periods>"

    @cached_property
    def metrics(self) -> dict[str, Any]:
        """Figures of the evaluation window, as one object of ``metrics.json`` holds them.

        A figure that the recording cannot give is None, and the notes say why.
        """
        return metrics.evaluate(self.recording)

    @property
    def notes(self) -> list[str]:
        """What has to be known beside the figures, such as a trip or missing messages."""
        return [note["text"] for note in self.metrics["notes"]]

    @cached_property
    def columns(self) -> dict[str, NDArray[Any]]:
        """All quantities by name, each of shape (n,), with the unit at the end of its name."""
        return columns(self.recording)

    @property
    def time(self) -> Array:
        """Start of each period (s), shape (n,)."""
        return self.columns["time_s"]

    @property
    def i_abc(self) -> Array:
        """Measured phase currents (A), shape (n, 3)."""
        return window.phase_currents(self.recording.feedback)

    @property
    def i_dq(self) -> NDArray[np.complex128]:
        """Measured current in the rotor frame, i_d + 1j i_q (A), shape (n,)."""
        return self._complex("i_d_A", "i_q_A")

    @property
    def i_dq_ref(self) -> NDArray[np.complex128]:
        """Reference of `i_dq` (A), shape (n,)."""
        return self._complex("i_d_ref_A", "i_q_ref_A")

    @property
    def prediction_error(self) -> NDArray[np.complex128]:
        """Measured minus predicted current (A), shape (n,)."""
        return self._complex("prediction_error_d_A", "prediction_error_q_A")

    @property
    def duty(self) -> Array:
        """Duties of the legs a, b, c that applied in each period (0..1), shape (n, 3)."""
        return np.stack([self._column(f"duty_{leg}") for leg in "abc"], axis=1)

    @property
    def w_M(self) -> Array:
        """True mechanical speed (rad/s), shape (n,); NaN for a recording without the truth."""
        return self._column("w_M_true_rad_per_s")

    @property
    def tau_M(self) -> Array:
        """True electromagnetic torque (N m), shape (n,); NaN for a recording without the truth."""
        return self._column("tau_M_true_N_m")

    def to_dataframe(self) -> pandas.DataFrame:
        """
        Return `columns` as a data frame of pandas, indexed by the period.

        Raises
        ------
        MissingPackageError
            If pandas is not installed.
        """
        try:
            import pandas
        except ImportError:
            raise MissingPackageError(
                "a data frame needs pandas: 'pip install pandas', or use the arrays in 'columns'"
            ) from None
        return pandas.DataFrame(self.columns).set_index("period")

    def _column(self, name: str) -> Array:
        values = self.columns.get(name)
        return np.full(len(self.time), np.nan) if values is None else values

    def _complex(self, real: str, imaginary: str) -> NDArray[np.complex128]:
        return self._column(real) + 1j * self._column(imaginary)


def run(
    experiment: str | Path | Scenario,
    *,
    scheme: str = "mls_mfpcc",
    plant: Mapping[str, Any] | None = None,
    controller: Mapping[str, Any] | None = None,
    seed: int = 0,
    engine: str = "inprocess",
    out: str | Path | None = None,
    progress: bool = False,
) -> Result:
    """
    Run an experiment with one scheme.

    Parameters
    ----------
    experiment : str, Path or Experiment
        A name of ``mfpcc list``, the path of a YAML file, or an experiment made in Python.
    scheme : str
        Who controls the current at the start.
    plant, controller : mapping, optional
        Parameters of the two nodes that shall differ from the experiment's, by name.
    seed : int
        Seed of all noise.
    engine : str
        ``inprocess``, or ``ros`` for the real graph; both give the same messages.
    out : str or Path, optional
        Folder for the recording with its metrics, figures and report, as ``mfpcc run`` leaves it;
        without it nothing is left on the disk.
    progress : bool
        Whether to show a progress bar on stderr.

    Returns
    -------
    Result
        The run; its `notes` tell what did not go as planned.

    Raises
    ------
    pwm_node.errors.ForPeople
        With the sentence that ``mfpcc run`` would print.
    """
    wanted = experiment if isinstance(experiment, Scenario) else scenario.load(experiment)
    wanted = scenario.with_parameters(wanted, plant=plant or {}, controller=controller or {})
    if engine not in ENGINES:
        raise ParameterError(unknown("engine", engine, ENGINES))
    wanted.node_parameters(scheme, seed)  # what cannot be run is refused before anything is made
    with ExitStack() as stack:
        if out is None:
            folder = stack.enter_context(scratch("mfpcc-run-"))
        else:
            folder = stack.enter_context(result_folder(Path(out)))
        tell = (
            stack.enter_context(progress_bar())(scheme, wanted.periods)
            if progress
            else lambda done: None
        )
        running.run(wanted, scheme, engine, folder, seed, tell)
        found = bags.read(folder / scheme)
        if out is not None:
            # matplotlib takes its time to load
            from mfpcc_experiments.reporting import compare

            compare.compare([folder / scheme], folder)
    found.path = Path(scheme) if out is None else Path(out, scheme)
    return Result(found)


def load(bag: str | Path, *, namespace: str | None = None) -> Result:
    """
    Load a recording.

    Parameters
    ----------
    bag : str or Path
        Folder of a bag, or one of its files.
    namespace : str, optional
        Which axis, of a recording that holds several (``/axis1``).

    Raises
    ------
    pwm_node.errors.ForPeople
        If it cannot be used; the sentence says why and what to do.
    """
    return Result(bags.read(Path(bag), namespace=namespace))
