"""A lack of RAM is one line, whoever notices it."""

import numpy as np
import pytest
import torch

from zipf.errors import UserError
from zipf.experiments.building.out_of_ram import enough_ram


def on_a_gpu():
    raise torch.OutOfMemoryError("Tried to allocate 2.00 GiB.\nMore.")


@pytest.mark.parametrize(
    ("allocate", "told"),
    [
        (lambda: torch.empty(2**60, dtype=torch.uint8), "not enough RAM (can't allocate memory"),
        (lambda: np.empty(2**60, np.uint8), "not enough RAM (Unable to allocate 1.00 EiB"),
        (lambda: bytearray(2**62), "not enough RAM"),
        (
            on_a_gpu,
            "on the GPU (Tried to allocate 2.00 GiB.)",
        ),
    ],
    ids=["pytorch", "numpy", "python", "gpu"],
)
def test_a_lack_of_ram_is_one_line(allocate, told):
    with pytest.raises(UserError) as error, enough_ram("fewer envs need less"):
        allocate()
    assert told in str(error.value)
    assert str(error.value).endswith("; fewer envs need less")
    assert len(str(error.value).splitlines()) == 1


def test_other_errors_stay_what_they_are():
    with pytest.raises(RuntimeError, match="shape"), enough_ram("less"):
        torch.zeros(3).reshape(2)
