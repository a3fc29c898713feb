#!/bin/sh
# Finds a Python to make the environment of, and runs set_up.py with it and the arguments given.
# PYTHON=... names the one to take. Otherwise: CPython 3.12 (which ROS 2 Jazzy is made for), then
# 3.13, 3.11, 3.10, on PATH or of pyenv, and at last whatever `python3` is. `set_up.sh --which`
# only tells which one it is.
here=$(cd -- "$(dirname -- "$0")" && pwd -P) || exit 1
newline='
'

# What changes how any Python starts, and was set for another one. PYTHONPATH is how a sourced ROS 2
# is found; without one there is nothing on it that is for us.
unset PYTHONHOME PYTHONSTARTUP PYTHONOPTIMIZE PYTHONINSPECT PYTHONEXECUTABLE PYTHONPLATLIBDIR \
    PYTHONWARNINGS PYTHONSAFEPATH PYTHONCASEOK PYTHONVERBOSE PYTHONBREAKPOINT __PYVENV_LAUNCHER__
[ -n "${ROS_DISTRO-}" ] || unset PYTHONPATH

# Pythons of a version ("3.12"): on PATH, and of pyenv, be it active in this shell or not.
of_version() {
    printf 'python%s\n' "$1"
    for interpreter in "${PYENV_ROOT:-${HOME-}/.pyenv}/versions/$1"*/bin/python; do
        case $interpreter in
            */"$1"/bin/python | */"$1".[0-9]*/bin/python) printf '%s\n' "$interpreter" ;;
        esac
    done
}

case ${PYTHON-} in
    '')
        # The Python of a sourced ROS 2 is the machine's own.
        [ -z "${ROS_DISTRO-}" ] || candidates=/usr/bin/python3$newline
        for version in 3.12 3.13 3.11 3.10; do
            candidates=${candidates-}$(of_version "$version")$newline
        done
        candidates=${candidates}python3
        ;;
    python3.* | 3.*) candidates=$(of_version "${PYTHON#python}") ;;
    *) candidates=$PYTHON ;;
esac

rejected=
IFS=$newline
set -f
for candidate in $candidates; do
    command -v "$candidate" >/dev/null 2>&1 || continue
    if answer=$("$candidate" "$here/check_python.py" 2>&1); then
        answer=${answer##*"$newline"}
        if [ -x "$answer" ]; then
            if [ "${1-}" = --which ]; then
                printf '%s\n' "$answer"
                exit
            fi
            exec "$answer" "$here/set_up.py" "$@"
        fi
        answer="says '$answer' instead of where it is"
    fi
    rejected="$rejected$newline  $candidate ${answer%%"$newline"*}"
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
