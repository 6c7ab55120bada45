#!/usr/bin/env bash
# Tells whether a change of the code has changed what it makes: bakes every row of the catalogue that
# takes less than a minute and renders every scene of the gallery with the programs of two folders, and
# compares bytes of bundles and of pictures. Ends with exit code 1 if anything differs.
# Usage: docs/unchanged.sh FOLDER_BEFORE FOLDER_AFTER, each with the programs `geofan` and `geofan-bake`,
# say `target/release` of two checkouts.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
before=$(realpath "$1") after=$(realpath "$2")
out=$(mktemp -d)
trap 'rm -rf "$out"' EXIT
bad=0

compare() { # name, the two files
    if cmp -s "$2" "$3"; then
        echo "same      $1"
    else
        echo "DIFFERENT $1"
        bad=1
    fi
}

bundles=(s3 h3-ball nil sol schwarzschild ellis-wormhole gaussian-lens gaussian-bump three-bumps)
for name in "${bundles[@]}"; do
    args=(--max-error 0.5 --certify-rays 2000 --quiet)
    file=assets/manifolds/$name.toml
    if [[ $name == three-bumps ]]; then
        sed -e 's|^parameters = { c.*|parameters = { c = [-1.0, 1.0] }|' -e 's|^at = \["c.*|at = ["c", "0.3", "0.2"]|' \
            "$file" >"$out/three-bumps.toml"
        file=$out/three-bumps.toml args+=(--length 8)
    fi
    for side in before after; do
        mkdir -p "$out/$side"
        "${!side}/geofan-bake" "$file" -o "$out/$side/$name.fan" "${args[@]}" >/dev/null || true
    done
    compare "bundle of $name" "$out"/{before,after}/"$name.fan"
done

picture() { # name, arguments of render
    local name=$1
    shift
    for side in before after; do
        "${!side}/geofan" render "$@" --size 160x90 --quiet -o "$out/$side/$name.png" || true
    done
    compare "picture of $name" "$out"/{before,after}/"$name.png"
}

for scene in assets/scenes/*.toml; do
    name=$(basename "$scene" .toml)
    [[ $name == wormhole-journey || $name == *-poses ]] && continue
    picture "$name, exact" "$scene"
done
picture "wormhole, table" assets/scenes/wormhole-gallery.toml --bundle "$out/before/ellis-wormhole.fan"
picture "wormhole, local" assets/scenes/wormhole-gallery.toml --tracer local
picture "caustic, paths" assets/scenes/bump-caustic.toml --tracer path --spp 2
exit $bad
