"""Bakes a manifold on a Dask cluster whose workers share a folder.

    python contrib/dask_bake.py MANIFOLD B.fan SHARDS [--scheduler tcp://HOST:8786] [-- further arguments of bake]

Without --scheduler a cluster of local processes is started. A worker that dies loses nothing: its task is run
again and goes on where it was.
"""

import argparse
import os
import pathlib
import subprocess

from dask.distributed import Client, as_completed

GEOFAN = os.environ.get("GEOFAN", "geofan")
RESUMABLE = 75


def bake(manifold: str, shard: str, share: str, options: list[str]) -> str:
    """Bakes one share; an interrupted bake raises, so that Dask runs it again."""
    command = [GEOFAN, "bake", manifold, "-o", shard, "--shard", share, "--resume", "--quiet", "--threads", "1"]
    done = subprocess.run(command + options, capture_output=True, text=True)
    if done.returncode == RESUMABLE or done.returncode < 0:
        raise RuntimeError(f"{shard} was interrupted: {done.stderr}")
    if done.returncode != 0:
        raise SystemExit(f"{shard}: {done.stderr}")
    return shard


def main() -> None:
    """Bakes all shares and merges them."""
    parser = argparse.ArgumentParser()
    parser.add_argument("manifold")
    parser.add_argument("output")
    parser.add_argument("shards", type=int)
    parser.add_argument("--scheduler")
    parser.add_argument("options", nargs="*")
    arguments = parser.parse_args()
    folder = pathlib.Path(arguments.output + ".shards").absolute()
    folder.mkdir(parents=True, exist_ok=True)
    local = {} if arguments.scheduler else {"threads_per_worker": 1}
    with Client(arguments.scheduler, **local) as client:
        tasks = [
            client.submit(
                bake,
                os.path.abspath(arguments.manifold),
                str(folder / f"{i}.fan"),
                f"{i}/{arguments.shards}",
                arguments.options,
                retries=3,
                pure=False,
            )
            for i in range(1, arguments.shards + 1)
        ]
        shards = sorted(task.result() for task in as_completed(tasks))
    subprocess.run([GEOFAN, "merge", *shards, "-o", arguments.output, "--quiet"], check=True)


if __name__ == "__main__":
    main()
