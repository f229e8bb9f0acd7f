#!/usr/bin/env bash
# SPDX-License-Identifier: MIT
#
# Controller and rig as two processes on a SocketCAN bus vcan0; a gear is asked
# for, candump records the bus, and `meshpoint replay --verify` runs the log
# through the controller again: byte for byte the same, or this script fails.
#
#     examples/vcan.sh [GEAR [FOLDER]]       default: gear 4, folder out/vcan
#
# Nothing of it needs this repository but tools/with-vcan, which gives it a
# vcan0: of this machine's kernel, or in an emulated machine.  There Python is
# some twenty times slower, so bus time goes at a twentieth of the wall clock's
# speed, and the kernels are compiled here, for any processor of the kind.
#
# Exit status: 0 engaged and verified, 1 not, 2 wrong arguments, 3 no vcan0 or
# nothing to verify (the message says which), else with-vcan's.
set -euo pipefail

readonly gear=${1:-4} folder=$(realpath -m -- "${2:-out/vcan}")
here=$(cd -- "$(dirname -- "$(readlink -f -- "${BASH_SOURCE[0]}")")" && pwd)
say() { printf '%s vcan.sh: %s\n' "$(date +%T)" "$*" >&2; }

# ------------------------------------------------------- on this machine ----

outside() {
    local way
    if ! [[ $gear =~ ^([1-9]|1[0-4])$ && $# -le 2 ]]; then
        say "usage: $0 [GEAR [FOLDER]], with GEAR 1 to 14, not '$gear'"
        exit 2
    fi
    type -P meshpoint >/dev/null || export PATH=$PATH:$here/../.venv/bin
    if ! type -P meshpoint >/dev/null; then
        say 'there is no command meshpoint; in the repository: make .venv/run.stamp'
        exit 2
    fi
    way=$("$here/../tools/with-vcan" --check) || { echo "$way" >&2; exit 3; }
    echo "$way"
    mkdir -p "$folder"
    rm -f "$folder"/{run.log,header-*.json,bus.time}
    # A controller on a real bus drives no valve unless it is armed.
    if meshpoint controller --help | grep -qe --arm; then export ARM=--arm; fi
    if [[ $way == direct* ]]; then
        say 'this takes about a minute; the first run after installing two, as it compiles'
        "$here/../tools/with-vcan" --timeout 600 "$here/vcan.sh" "$gear" "$folder"
    else
        say 'this takes about 4 minutes, beside much other work up to 15: the machine is emulated'
        say 'nothing is seen while it boots: a fifth of that time'
        # The emulated processor would compile for an hour; it takes this machine's kernels.
        "$(dirname -- "$(type -P meshpoint)")/python" -m meshpoint.bench.compiling
        "$here/../tools/with-vcan" --timeout 1800 --keep "$folder" \
            "$here/vcan.sh" "$gear" "$folder"
    fi
    say 'replaying the log through the controller'
    meshpoint replay "$folder/run.log" --verify
    say "done: gear $gear was engaged, and the log is verified"
    if [[ $way != direct* ]]; then
        say 'where the log is silent, bus time waited for a node: candump stamps with the wall clock'
    fi
}

# ---------------------------------------------------- where there is vcan0 --

inside() {
    local speed=1 patience=60 status=0 first node
    local rig=(--gear 2 --main-speed 300) controller=(${ARM:+"$ARM"})
    local bus=(-i socketcan -c vcan0 --fd)
    if [[ $WITH_VCAN == qemu ]]; then speed=0.05 patience=1200; fi
    trap 'kill $(jobs -p) 2>/dev/null || true' EXIT
    cd "$folder"
    candump -D -L vcan0 >run.log &
    local candump=$!
    meshpoint up --pace-only bus.time --speed "$speed" &
    local pace=$!
    until [[ -e bus.time ]]; do sleep 0.1; kill -0 "$pace"; done
    say 'rig and controller are starting'
    meshpoint rig "${rig[@]}" --pace bus.time --speed "$speed" "${bus[@]}" &
    local nodes=("$!")
    meshpoint controller "${controller[@]}" --header-dir . \
        --pace bus.time --speed "$speed" "${bus[@]}" &
    nodes+=("$!")
    say "asking for gear $gear"
    meshpoint request "$gear" --timeout "$patience" "${bus[@]}" &
    local request=$!
    wait -n -p first "$request" "${nodes[@]}" || status=$?
    if [[ $first != "$request" ]]; then
        # Nobody is left to answer: the request would wait until its patience ends.
        say "a node ended with exit code $status before the gear was engaged"
        status=1
        kill "$request"
    fi
    for node in "${nodes[@]}"; do
        [[ $node != "$first" ]] || continue
        kill -TERM "$node" 2>/dev/null || true
        wait "$node" || { say "a node ended with exit code $?"; status=1; }
    done
    kill -TERM "$candump" "$pace"
    wait "$candump" "$pace" || true
    say "$(wc -l <run.log) frames recorded in $folder/run.log"
    return "$status"
}

if [[ ${WITH_VCAN-} ]]; then inside; else outside "$@"; fi
