"""Recordings of strangers read nothing outside their folder: no absolute paths, no `..`, no links that lead out."""

from pathlib import Path
from typing import Any

from midspan.errors import DataError
from midspan.scale.jobs import Job, files_of, named_files
from midspan.settings.load import load_settings

# Why a path is refused.
OUTSIDE = "leads out of the recording's folder, which a campaign does not read. Copy the file into it."
HDF5 = (".h5", ".hdf5", ".hdf", ".mat")


def require_confined(job: Job) -> None:
    """DataError, naming the file, where a recording's settings or files lead out of its folder."""
    if job.second is not None:
        # The campaign's own table names them.
        return
    folder = job.path.parent.resolve()
    for name in named_files(load_settings(job.path)):
        path = Path(name)
        if path.is_absolute() or ".." in path.parts:
            raise DataError(f"{job.path}: {name!r} {OUTSIDE}")
    for path in files_of(job):
        if path == job.calibration:
            continue
        if not path.resolve().is_relative_to(folder):
            raise DataError(f"{path}: is a link that {OUTSIDE}")
        if path.suffix.lower() in HDF5 and path.is_file():
            _require_no_external_links(path)


def _require_no_external_links(path: Path) -> None:
    """DataError where a file of HDF5 takes data from another file."""
    import h5py

    if not h5py.is_hdf5(path):
        return
    with h5py.File(path) as file:
        pending: list[Any] = [file]
        visited = set[Any]()
        while pending:
            group = pending.pop()
            for name in group:
                link = group.get(name, getlink=True)
                if isinstance(link, h5py.ExternalLink):
                    raise DataError(
                        f"{path}: {name} is a link to another file, which a campaign does not read. Copy the data."
                    )
                member = group.get(name)
                if isinstance(member, h5py.Dataset) and (member.external or member.is_virtual):
                    raise DataError(
                        f"{path}: {name} takes its data from other files, which a campaign does not read. Copy them."
                    )
                if isinstance(member, h5py.Group) and member.id not in visited:
                    visited.add(member.id)
                    pending.append(member)
