import os
import subprocess
import sys

import pytest

from pwm_node.ros.only_one import TakenError, claim


@pytest.fixture(autouse=True)
def _apart(tmp_path, monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))


def test_a_name_is_there_once_and_again_after_its_end():
    first = claim("/axis1/plant", 3)
    with pytest.raises(TakenError, match="two nodes of this process would be named /axis1/plant"):
        claim("/axis1/plant", 3)
    for name, domain in (("/axis2/plant", 3), ("/axis1/plant", 4)):
        os.close(claim(name, domain))
    os.close(first)
    os.close(claim("/axis1/plant", 3))


def test_a_killed_process_has_no_claim(tmp_path):
    program = (
        "import os, tempfile; from pwm_node.ros.only_one import claim\n"
        f"tempfile.tempdir = {str(tmp_path)!r}; claim('/plant', 0); print(flush=True); input()"
    )
    command = [sys.executable, "-c", program]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
        process.stdout.readline()
        with pytest.raises(TakenError, match=f"/plant is running .*process {process.pid},"):
            claim("/plant", 0)
        process.kill()
    os.close(claim("/plant", 0))


def test_without_a_place_for_the_lock_it_goes_on(tmp_path, monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "nowhere"))
    assert claim("/plant", 0) is None
