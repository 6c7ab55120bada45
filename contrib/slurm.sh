#!/usr/bin/env bash
# Bakes a manifold on a Slurm cluster: an array of tasks, one for each shard, and a merge behind them.
# Usage: contrib/slurm.sh MANIFOLD B.fan SHARDS [further arguments of geofan bake]
# GEOFAN (default: geofan) names the program; SBATCH_* variables choose partition, account and so on.
set -euo pipefail
manifold=$1 output=$2 shards=$3
shift 3
geofan=${GEOFAN:-geofan}
folder=$output.shards
mkdir -p "$folder"

# A task that is about to be stopped gets SIGTERM a minute before, ends with what it has kept, and goes on where it
# was when Slurm starts it again. `exec`: the signal reaches the bake itself.
array=$(sbatch --parsable --array="1-$shards" --requeue --signal=B:TERM@60 --open-mode=append \
    --job-name=geofan-bake --output="$folder/%a.log" --wrap \
    "exec \"$geofan\" bake \"$manifold\" -o \"$folder/\$SLURM_ARRAY_TASK_ID.fan\" --shard auto --resume --quiet $*")
merge=$(sbatch --parsable --dependency="afterok:$array" --kill-on-invalid-dep=yes \
    --job-name=geofan-merge --output="$folder/merge.log" --wrap \
    "exec \"$geofan\" merge \"$folder\"/*.fan -o \"$output\" --quiet")
echo "tasks $array, merge $merge; logs in $folder"
