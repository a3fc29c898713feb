"""The files of a black box: a folder of bags, with a list of what is in them."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import yaml

from mfpcc_experiments.bags import BagWriter, versions
from mfpcc_experiments.graph.excerpt import STATUS, gently
from mfpcc_experiments.scratch import scratch
from pmsm_sim import motor
from pwm_node.yaml_files import FileError

#: Faults of which bag and figures are kept; the oldest makes room.
KEPT = 25

#: The list of them, in the directory; and the same for one, beside its bag.
LIST, PAGE = "trips.yaml", "trip.yaml"

_Dumper: Any = getattr(yaml, "CSafeDumper", yaml.SafeDumper)  # a tenth of the time


class Archive:
    """The directory of the bags, with the list of what is in them.

    Parameters
    ----------
    directory : Path
        Made when there is something to put into it.
    """

    def __init__(self, directory: Path) -> None:
        self.directory = directory.absolute()

    @contextmanager
    def new(self, name: str) -> Iterator[Path]:
        """Yield the folder to write bag and page into; whole, it takes its place in the list.

        Parameters
        ----------
        name : str
            Of the bag; in the order of these names the oldest makes room.

        Raises
        ------
        OSError
            Nothing has changed then.
        """
        self.directory.mkdir(parents=True, exist_ok=True)
        with scratch(".partial-", self.directory) as work:
            folder = work / name
            yield folder
            folder.rename(self.directory / name)
            pages = sorted(self.directory.glob(f"*/{PAGE}"), reverse=True)
            # each page is a list of one, so one after the other they are the list
            text = "".join(page.read_text(encoding="utf-8") for page in pages[:KEPT])
            (work / LIST).write_text(_HEAD + text, encoding="utf-8")
            os.replace(work / LIST, self.directory / LIST)
            for page in pages[KEPT:]:
                page.parent.rename(work / page.parent.name)


_HEAD = f"""\
# The last {KEPT} faults, newest first; the values are those of the period in which each was seen.
# Each has a bag beside this file: 'mfpcc compare BAG'.
"""


def as_yaml(data: Any) -> str:
    """Plain data as YAML, in the order they have."""
    text: str = yaml.dump(data, Dumper=_Dumper, sort_keys=False, default_flow_style=None, width=100)
    return text


def configuration(
    code: str, pwm_frequency: float, values: Mapping[str, Mapping[str, Any]]
) -> dict[str, Any]:
    """What a recording of the verb `run` has too, as far as it is known."""
    config: dict[str, Any] = {
        "experiment": f"trip {code}",
        "engine": "ros",
        "T_s": 1.0 / pwm_frequency,
        "versions": versions(),
    }
    plant = values.get("pmsm_sim")
    if values:
        config["parameters"] = dict(values)
    if plant is not None:
        with suppress(FileError):  # the file of a node elsewhere may not be here
            machine = motor.load(plant["motor"])
            config |= {"motor": machine.name, "n_p": machine.n_p, "R_s": machine.R_s}
            config["motor_file"] = machine.model_dump(mode="json")
    return config


def write_bag(
    folder: Path,
    config: Mapping[str, Any],
    namespace: str,
    messages: Iterable[tuple[int, int, str, bytes]],
    summary: Mapping[str, Any],
) -> None:
    """Write the bag of a trip, without holding up the loop.

    Parameters
    ----------
    folder : Path
        The new bag.
    config : mapping
        From `configuration`.
    namespace : str
        Of the drive.
    messages : iterable
        Stamp (ns), rank, topic, serialized message, as time passes.
    summary : mapping
        What is stored at the end.
    """
    oversampling = config.get("parameters", {}).get("pmsm_sim", {}).get("oversampling", 0)
    with BagWriter(folder, config=config, oversampling=oversampling, namespace=namespace) as writer:
        writer.add_topic(STATUS, "mfpcc_msgs/msg/DriveStatus")
        for stamp, _, topic, data in gently(messages):
            writer.write(topic, stamp, data)
        writer.close(summary)
