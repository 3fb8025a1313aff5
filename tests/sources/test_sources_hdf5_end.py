"""HDF5 files into which bytes were put: the library may follow them for ever, so they are refused by their own end."""

import h5py
import numpy as np
import pytest

from midspan.errors import DataError
from midspan.sources.hdf5_members import open_hdf5


@pytest.mark.parametrize("libver", ["earliest", "latest"])
@pytest.mark.parametrize("block", [0, 512])
def test_a_file_that_goes_on_behind_its_end_is_refused(tmp_path, libver, block):
    path = tmp_path / "a.h5"
    with h5py.File(path, "w", libver=libver, userblock_size=block) as file:
        file["x"] = np.arange(1000.0)
    with open_hdf5(path) as file:
        np.testing.assert_array_equal(file["x"], np.arange(1000.0))
    data = path.read_bytes()
    path.write_bytes(data[:3000] + data[2000:])
    with pytest.raises(DataError, match="is damaged: it has"):
        open_hdf5(path)
