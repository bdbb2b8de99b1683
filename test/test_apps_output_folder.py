# SPDX-License-Identifier: Apache-2.0
"""What stops a folder from being written is said of the folder that was asked for."""

from __future__ import annotations

from pathlib import Path

import pytest

from rpgd_ros.apps.output_folder import check_output, scratch_folder
from rpgd_ros.core.errors import InputError, Reason
from rpgd_ros.io.atomic import write_atomic


@pytest.mark.parametrize('name', ['x' * 300, f'{"x" * 300}/output'])
def test_a_name_that_is_too_long_is_refused(tmp_path: Path, name: str) -> None:
    """As everything else that cannot be written."""
    with pytest.raises(InputError, match='File name too long') as refused:
        check_output(tmp_path / name, (), is_forced=False)
    assert refused.value.reason is Reason.NOT_WRITABLE


def test_a_failure_within_the_scratch_folder_names_the_output(tmp_path: Path) -> None:
    """The scratch folder is gone when somebody reads of it."""
    output = tmp_path / 'output'
    with (
        pytest.raises(InputError, match=f'^not_writable: {output}/xxx'),
        scratch_folder(output) as scratch,
    ):
        write_atomic(scratch / ('x' * 300), b'')
    assert list(tmp_path.iterdir()) == []
