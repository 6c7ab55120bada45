#!/usr/bin/env bash
# The long runs of docs/trust.md, each with a log below target/trust. Needs the tests compiled
# (`cargo test --release --workspace --no-run`). Usage: docs/trust.sh COMMAND
#   mutations FIRST LAST KIND...   parts with these keys, on one thread; kinds: resealed, texts, pictures, plain
#   count                          sums up what all parts have done so far
#   kills [N]                      N kills of each writing command (50)
#   faults                         a fault at every event of every writing command
#   merge [MB...]                  memory of a merge against the bytes of its shards
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
out=target/trust
mkdir -p "$out"

newest() { # name of a test
    local found
    found=$(find target/release/deps -maxdepth 1 -name "$1-*" -type f -executable -printf '%T@ %p\n' | sort -rn | head -1)
    [[ -n $found ]] || { echo "compile the test $1 first" >&2 && exit 2; }
    echo "$PWD/${found#* }"
}

# One part of a kind: thousands of inputs for each of its readers. A hundred parts of all kinds, but ten of `plain`, are ten
# million bundles, half of them changed below their checksums, and a million texts.
part() { # key, kind
    local -A readers=(
        [plain]='500 changed_bundles_do_not_panic'
        [resealed]='49 bundles_changed_below_their_checksums_do_not_panic 1 hostile_tables_do_not_panic'
        [texts]='2 changed_manifolds_do_not_panic 2 changed_scenes_do_not_panic 2 changed_meshes_do_not_panic
            1 changed_materials_do_not_panic 2 changed_camera_paths_do_not_panic 1 changed_messages_do_not_panic'
        [pictures]='1 changed_pictures_do_not_panic'
    )
    local -a words
    read -r -d '' -a words <<<"${readers[$2]}" || true
    local k
    for ((k = 0; k < ${#words[@]}; k += 2)); do
        GEOFAN_FUZZ_KEY=$1 GEOFAN_FUZZ_RUNS=$((words[k] * 1000)) RAYON_NUM_THREADS=1 \
            nice -n 19 "$fuzzing" --exact "${words[k + 1]}" --nocapture --test-threads 1 2>&1 |
            grep -oE '[a-z_]+: key .*|.*panicked.*|fatal runtime error.*|memory allocation of .*' >>"$out/mutations.log" ||
            printf 'FAILED: %s, key %s\n' "${words[k + 1]}" "$1" >>"$out/mutations.log"
    done
}

case ${1:-} in
mutations)
    # A copy: the test may be compiled again meanwhile.
    fuzzing=$PWD/$out/fuzzing-$2-$3-$4
    cp "$(newest fuzzing)" "$fuzzing"
    for kind in "${@:4}"; do
        for key in $(seq "$2" "$3"); do part "$key" "$kind"; done
    done
    ;;
count)
    echo '| reader | inputs | parts | longest, bytes | slowest, ms | memory, MB |'
    echo '|---|---|---|---|---|---|'
    sed -nE 's/.*\b([a-z_]+): key ([0-9]+), ([0-9]+) inputs, longest ([0-9]+) bytes; slowest [0-9]+ \([0-9]+ bytes\) ([0-9.]+) ms; memory ([0-9]+) kB before, ([0-9]+) kB.*/\1 \2 \3 \4 \5 \6 \7/p' \
        "$out/mutations.log" | sort -k1,1 -k2,2n | awk '
        { n[$1] += $3; keys[$1]++
          if ($4 > long[$1]) long[$1] = $4
          if ($5 > slow[$1]) slow[$1] = $5
          if ($7 - $6 > most[$1]) most[$1] = $7 - $6 }
        END { for (k in n) printf "| %s | %d | %d | %d | %.1f | %.1f |\n", k, n[k], keys[k], long[k], slow[k], most[k] / 1000 }' | sort
    echo "failed: $(grep -c FAILED "$out/mutations.log" || true)"
    ;;
kills)
    GEOFAN_KILLS=${2:-50} nice -n 19 "$(newest kills)" --nocapture --test-threads 1 2>&1 | tee "$out/kills.log"
    ;;
faults)
    GEOFAN_FAULTS=all nice -n 19 "$(newest file_faults)" --nocapture --test-threads 1 2>&1 | tee "$out/faults.log"
    ;;
merge)
    shift
    [[ $# -gt 0 ]] || set -- 10 100 1000
    for megabytes in "$@"; do
        GEOFAN_MERGE_MB=$megabytes nice -n 19 "$(newest merge_memory)" --nocapture --test-threads 1 2>&1
    done | tee "$out/merge.log"
    ;;
*)
    sed -n '2,8p' "${BASH_SOURCE[0]}"
    exit 2
    ;;
esac
