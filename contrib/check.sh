#!/usr/bin/env bash
# Runs Slurm, GNU parallel, Snakemake and Dask for real on this machine, each with a bake that is killed on the
# way, and compares the merged bundles with that of an undivided bake, byte for byte. Needs root (Slurm's daemons)
# and `cargo build --release`; on Debian it installs what is missing. Usage: contrib/check.sh [ENGINE...]
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
root=$PWD
work=$(mktemp -d)
# A copy: the program may be compiled again meanwhile.
cp "$root/target/release/geofan" "$work/geofan"
export GEOFAN=$work/geofan
trap 'stop_slurm; sleep 1; rm -rf "$work"' EXIT
manifold=$root/assets/manifolds/three-bumps.toml
shards=4
# A box of cameras in cells: shards of some seconds each, in chunks of half a second, so that there is something to kill.
options=(--max-error 20 --length 1.5 --cells 3 --certify-rays 1000)

install() { # command, packages
    command -v "$1" >/dev/null || { apt-get update -qq && DEBIAN_FRONTEND=noninteractive apt-get install -y -qq "${@:2}" >/dev/null; }
}

python_engines() {
    [[ -x $work/venv/bin/snakemake ]] && return
    python3 -m venv "$work/venv"
    "$work/venv/bin/pip" -q install snakemake "dask[distributed]"
}

# Kills the first bake of a shard that has begun to keep chunks.
kill_one() { # folder
    local pid
    for _ in $(seq 6000); do
        if compgen -G "$1/*.parts/chunk-*" >/dev/null; then
            pid=$(pgrep -n -f "geofan bake .*$1/" || true)
            if [[ -n $pid ]] && kill -KILL "$pid" 2>/dev/null; then
                echo "killed $pid"
                return
            fi
        fi
        sleep 0.1
    done
    echo "nothing to kill" >&2
    return 1
}

start_slurm() {
    install slurmctld slurm-wlm munge
    mkdir -p /run/munge && chown munge: /run/munge
    pgrep munged >/dev/null || sudo -u munge /usr/sbin/munged 2>/dev/null || su munge -s /bin/sh -c /usr/sbin/munged
    mkdir -p "$work/slurm"
    cat >"$work/slurm/slurm.conf" <<CONF
ClusterName=geofan
SlurmctldHost=$(hostname -s)
SlurmUser=root
StateSaveLocation=$work/slurm
SlurmdSpoolDir=$work/slurm
SlurmctldPidFile=$work/slurm/slurmctld.pid
SlurmdPidFile=$work/slurm/slurmd.pid
SlurmctldLogFile=$work/slurm/slurmctld.log
SlurmdLogFile=$work/slurm/slurmd.log
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
SelectType=select/cons_tres
JobRequeue=1
JobCompType=jobcomp/none
AccountingStorageType=accounting_storage/none
MailProg=/bin/true
NodeName=$(hostname -s) CPUs=$(nproc) State=UNKNOWN
PartitionName=all Nodes=ALL Default=YES MaxTime=INFINITE State=UP
CONF
    export SLURM_CONF=$work/slurm/slurm.conf
    /usr/sbin/slurmctld && /usr/sbin/slurmd
    for _ in $(seq 60); do
        sinfo -h -o %T 2>/dev/null | grep -q idle && return
        sleep 0.5
    done
    cat "$work"/slurm/*.log >&2
    return 1
}

stop_slurm() {
    [[ -d $work/slurm ]] || return 0
    pkill -F "$work/slurm/slurmd.pid" 2>/dev/null || true
    pkill -F "$work/slurm/slurmctld.pid" 2>/dev/null || true
}

slurm() {
    start_slurm
    contrib/slurm.sh "$manifold" "$work/slurm.fan" $shards "${options[@]}"
    # Slurm's own way to stop a task and start it again: the bake gets SIGTERM and keeps what it has.
    for _ in $(seq 6000); do
        compgen -G "$work/slurm.fan.shards/*.parts/chunk-*" >/dev/null && break
        sleep 0.1
    done
    local task
    task=$(squeue -h -t running -o %A -n geofan-bake | head -1)
    scontrol requeue "$task"
    echo "requeued task $task"
    while squeue -h | grep -q .; do
        # A requeued task waits two minutes unless it is released.
        scontrol update jobid="$task" starttime=now 2>/dev/null || true
        sleep 1
    done
}

parallel_() {
    install parallel parallel
    kill_one "$work/parallel.fan.shards" &
    PARALLEL_OPTIONS="--jobs 2 --will-cite" contrib/parallel.sh "$manifold" "$work/parallel.fan" $shards "${options[@]}"
    wait $!
}

snakemake() {
    python_engines
    kill_one "$work/snakemake.fan.shards" &
    "$work/venv/bin/snakemake" -s contrib/Snakefile --directory "$work" --cores 2 --quiet all --config \
        manifold="$manifold" output="$work/snakemake.fan" shards=$shards geofan="$GEOFAN" options="${options[*]}"
    wait $!
}

dask() {
    python_engines
    kill_one "$work/dask.fan.shards" &
    "$work/venv/bin/python" contrib/dask_bake.py "$manifold" "$work/dask.fan" $shards -- "${options[@]}"
    wait $!
}

# The merge may miss its promise; the bytes count.
"$GEOFAN" bake "$manifold" -o "$work/whole.fan" --quiet "${options[@]}" || [[ $? == 1 ]]
echo "undivided: $(stat -c %s "$work/whole.fan") bytes"
engines=("$@")
[[ $# -gt 0 ]] || engines=(slurm parallel snakemake dask)
for engine in "${engines[@]}"; do
    case $engine in
    parallel) parallel_ ;;
    *) "$engine" ;;
    esac
    cmp "$work/whole.fan" "$work/$engine.fan"
    echo "$engine: the same $(stat -c %s "$work/$engine.fan") bytes"
done
