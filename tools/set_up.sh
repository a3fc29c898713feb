#!/bin/sh
# Finds a Python to make the environment of, and runs set_up.py with it and the arguments given.
# PYTHON=... names the one to take. Otherwise: CPython 3.12 (which ROS 2 Jazzy is made for), then
# 3.13, 3.11, 3.10, on PATH or of pyenv, and at last whatever `python3` is.
here=$(cd -- "$(dirname -- "$0")" && pwd -P) || exit 1
newline='
'

candidates=${PYTHON-}
if [ -z "$candidates" ]; then
    # The Python of a sourced ROS 2 is the machine's own.
    [ -z "${ROS_DISTRO-}" ] || candidates=/usr/bin/python3
    pyenv=$(command -v pyenv >/dev/null 2>&1 && pyenv root 2>/dev/null)
    for version in 3.12 3.13 3.11 3.10; do
        candidates=$candidates${newline}python$version
        for interpreter in ${pyenv:+"$pyenv/versions/$version".*/bin/python}; do
            candidates=$candidates$newline$interpreter
        done
    done
    candidates=$candidates${newline}python3
fi

rejected=
IFS=$newline
for candidate in $candidates; do
    command -v "$candidate" >/dev/null 2>&1 || continue
    if answer=$("$candidate" "$here/check_python.py" 2>&1); then
        exec "$answer" "$here/set_up.py" "$@"
    fi
    rejected="$rejected$newline  $candidate $(printf '%s\n' "$answer" | head -n 1)"
done

{
    echo "set-up: needs CPython 3.10 to 3.13 (3.12 is best), with venv; there is none here."
    [ -z "${PYTHON-}" ] || echo "Asked for with PYTHON=$PYTHON."
    [ -z "$rejected" ] || echo "Looked at:$rejected"
    [ -z "${ROS_DISTRO-}" ] || echo "In a shell without ROS_DISTRO, ROS 2 comes from PyPI instead."
    echo "Install one (on Debian and Ubuntu: apt install python3 python3-venv), or name it:"
    echo "  make setup PYTHON=/path/to/python3.12"
} >&2
exit 1
