"""The system clock is set while the drive runs.

Nothing of ours asks for it but the stamp of /diagnostics. rclpy's executor in the wheels waits by
it, though, so that a clock set back holds up whoever is waiting for the time alone: the paced mode
(docs/reliability.md).
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from harness import PATIENCE, Process
from outside import Outside

#: C library functions with a system clock that is off by as many seconds as a file has bytes (the
#: sign is in `SIGN`). A wait for a time of that clock looks at it again and again, as the kernel
#: does; times too small for a date are of the monotonic clock, which is what it is.
CLOCK = """
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <pthread.h>
#include <stdlib.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <sys/time.h>
#include <time.h>
#include <unistd.h>
static long off(void) {
    struct stat file;
    return stat(getenv("OFFSET"), &file) ? 0 : atol(getenv("SIGN")) * file.st_size;
}
int clock_gettime(clockid_t clock, struct timespec *t) {
    int result = syscall(SYS_clock_gettime, clock, t);
    if (clock == CLOCK_REALTIME || clock == CLOCK_REALTIME_COARSE) t->tv_sec += off();
    return result;
}
int gettimeofday(struct timeval *restrict t, void *restrict zone) {
    struct timespec now;
    clock_gettime(CLOCK_REALTIME, &now);
    t->tv_sec = now.tv_sec;
    t->tv_usec = now.tv_nsec / 1000;
    return 0;
}
time_t time(time_t *at) {
    struct timespec now;
    clock_gettime(CLOCK_REALTIME, &now);
    if (at) *at = now.tv_sec;
    return now.tv_sec;
}
static long long ns(const struct timespec *t) { return t->tv_sec * 1000000000LL + t->tv_nsec; }
int pthread_cond_timedwait(pthread_cond_t *condition, pthread_mutex_t *mutex,
                           const struct timespec *until) {
    int (*wait)(pthread_cond_t *, pthread_mutex_t *, const struct timespec *) =
        dlsym(RTLD_NEXT, "pthread_cond_timedwait");
    if (until->tv_sec < 1000000000) return wait(condition, mutex, until);
    for (;;) {
        struct timespec now, end;
        clock_gettime(CLOCK_REALTIME, &now);
        long long left = ns(until) - ns(&now);
        if (left <= 0) return ETIMEDOUT;
        syscall(SYS_clock_gettime, CLOCK_REALTIME, &end);
        long long next = ns(&end) + (left < 20000000 ? left : 20000000);
        end.tv_sec = next / 1000000000;
        end.tv_nsec = next % 1000000000;
        int result = wait(condition, mutex, &end);
        if (result != ETIMEDOUT) return result;
    }
}
"""

HOUR = 3600  # s
Start = Callable[..., Process]
SetClock = Callable[[], None]


@pytest.fixture
def outside(domain: int) -> Iterator[Outside]:
    it = Outside()  # with the machine's own clock
    yield it
    it.close()


@pytest.fixture
def make_clock(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[int], SetClock]:
    """Give the processes started from now on a clock that can be set: by an hour, this way."""
    compiler = shutil.which("cc") or shutil.which("gcc")
    if compiler is None or not sys.platform.startswith("linux"):
        pytest.skip("needs a C compiler and Linux")

    def make(sign: int) -> SetClock:
        source, library, offset = (tmp_path / name for name in ("clock.c", "clock.so", "offset"))
        source.write_text(CLOCK)
        command = [compiler, "-shared", "-fPIC", "-o", str(library), str(source), "-ldl"]
        subprocess.run(command, check=True, timeout=PATIENCE)
        for name, value in (("LD_PRELOAD", library), ("OFFSET", offset), ("SIGN", sign)):
            monkeypatch.setenv(name, str(value))

        def set_clock() -> None:
            offset.write_bytes(bytes(HOUR))
            program = "import time; print(time.time())"
            shown = subprocess.run(
                [sys.executable, "-c", program], capture_output=True, timeout=PATIENCE
            )
            assert abs(float(shown.stdout) - time.time() - sign * HOUR) < 600.0, shown

        return set_clock

    return make


@pytest.mark.parametrize(("sign", "factor"), [(1, 0.02), (1, 0.0), (-1, 0.0)])
def test_the_drive_does_not_look_at_the_system_clock(
    start: Start,
    outside: Outside,
    make_clock: Callable[[int], SetClock],
    sign: int,
    factor: float,
) -> None:
    set_clock = make_clock(sign)
    drive = start("mfpcc_experiments", "drive", "--ros-args", "-p", f"real_time_factor:={factor}")
    outside.until_beyond(20, "the drive runs")
    set_clock()
    for _ in range(20):
        outside.look()  # what was on its way
    outside.until_beyond(outside.period + 200, "the drive goes on")
    assert not outside.codes("pmsm_sim") and not outside.codes("mfpcc_controller"), drive.output
