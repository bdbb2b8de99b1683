# SPDX-License-Identifier: Apache-2.0
"""Prints the default's answers to a few simulated cases, to compare versions of the libraries.

python test/converged.py > a.json          # with one set of versions
python test/converged.py a.json            # with another: exits 1 where they differ
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import cv2
import numpy as np

from rpgd_ros.core import calibrate
from rpgd_ros.simulation import twin
from rpgd_ros.simulation.presets import OutlierKind

TOLERANCE = 1e-6  # of a rotation's elements and of metres: a tenth of the best sigma of the cases
CASES: tuple[tuple[str, float, OutlierKind], ...] = (
    ('human36m', 0.0, 'uniform'),
    ('human36m', 0.6, 'mixed'),
    ('mpi_inf_3dhp', 0.3, 'swap'),
    ('aistpp', 0.4, 'person'),
    ('kinect', 0.2, 'uniform'),
)


def answers() -> dict[str, list[float]]:
    """Return rotation and translation of each case, as 12 numbers."""
    found = {}
    for shape, ratio, kind in CASES:
        case = twin(shape, 300, 1, outlier_ratio=ratio, kind=kind)
        pose = calibrate(case.cameras, case.observations).world_T_mocap
        found[f'{shape} {ratio} {kind}'] = [*pose.rotation.ravel(), *pose.translation]
    return found


def main() -> int:
    """Print the answers, or compare them with those of a file."""
    mine = answers()
    if len(sys.argv) < 2:
        sys.stdout.write(json.dumps(mine) + '\n')
        return 0
    theirs = json.loads(Path(sys.argv[1]).read_text())
    apart = {name: float(np.abs(np.subtract(mine[name], theirs[name])).max()) for name in mine}
    sys.stdout.write(f'numpy {np.__version__}, OpenCV {cv2.__version__}, largest difference:\n')
    for name, value in apart.items():
        sys.stdout.write(f'  {name}: {value:.1e}\n')
    return int(max(apart.values()) > TOLERANCE)


if __name__ == '__main__':
    sys.exit(main())
