#!/usr/bin/env bash
# Bakes a manifold with GNU parallel, on this machine or, with --sshlogin in PARALLEL_OPTIONS, on others that
# share the folder. Usage: contrib/parallel.sh MANIFOLD B.fan SHARDS [further arguments of geofan bake]
# A bake that is killed is started again and goes on where it was.
set -euo pipefail
manifold=$1 output=$2 shards=$3
shift 3
geofan=${GEOFAN:-geofan}
folder=$output.shards
mkdir -p "$folder"
# shellcheck disable=SC2086 # the options are words
seq "$shards" | parallel ${PARALLEL_OPTIONS:-} --halt soon,fail=1 --retries 3 --joblog "$folder/jobs.log" \
    "$geofan" bake "$manifold" -o "$folder/{}.fan" --shard "{}/$shards" --resume --quiet "$@"
"$geofan" merge "$folder"/*.fan -o "$output" --quiet
