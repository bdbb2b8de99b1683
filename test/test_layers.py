# SPDX-License-Identifier: Apache-2.0
"""The shape of the code, read from its syntax: who imports whom, and what nobody does."""

from __future__ import annotations

import ast
import re
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = 'rpgd_ros'
MAX_FILE_LINES = 300
MAX_FUNCTION_LINES = 60
SPDX = '# SPDX-License-Identifier: Apache-2.0'

WORKERS = frozenset({'core', 'skeletons', 'messages', 'io'})
SESSION = WORKERS | {'pairing'}
# The rooms that a room may import. The arrows go one way: data flow down this list.
ROOMS = {
    'core': frozenset[str](),
    'skeletons': frozenset({'core'}),
    'messages': frozenset({'core'}),
    'pairing': frozenset({'core'}),
    'io': SESSION - {'io'},
    'session': SESSION,
    'datasets': WORKERS,
    'importing': WORKERS,
    'simulation': WORKERS,
    'report': WORKERS,
    'ros': SESSION | {'session'},
    'launch': frozenset[str](),
    'apps': SESSION | {'session', 'datasets', 'importing', 'simulation', 'report', 'ros'},
}
# The programs that need ROS; all others run where it was never installed.
ROS_PROGRAMS = frozenset({
    f'{PACKAGE}.apps.bench_live', f'{PACKAGE}.apps.calibrator', f'{PACKAGE}.apps.demo',
})  # fmt: skip

# The modules of that room that say what the node is told and tells: they need no ROS.
ROS_FREE = frozenset({
    f'{PACKAGE}.ros.{name}'
    for name in ('found', 'job', 'parameters', 'parameters_file', 'parameters_text', 'settings',
                 'setup')
})  # fmt: skip

# The one module that reads pickles: nothing that they name is found (test_datasets_pickles.py).
PICKLE_READER = f'{PACKAGE}.datasets.pickles'

ROS_MODULES = frozenset({
    'action_msgs', 'ament_index_python', 'builtin_interfaces', 'diagnostic_msgs', 'geometry_msgs',
    'rcl_interfaces', 'rclpy', 'rosgraph_msgs', 'rosidl_runtime_py', 'sensor_msgs', 'std_msgs',
    'std_srvs', 'tf2_msgs', 'visualization_msgs',
})  # fmt: skip
# Messages of drivers, which those who have the driver have installed.
DRIVER_MODULES = frozenset({
    'hri_msgs', 'mocap4r2_msgs', 'motion_capture_tracking_interfaces', 'openpose_ros2_msgs',
    'xsens_mvn_msgs', 'xsens_mvn_ros_msgs', 'yolo_msgs', 'yolov8_msgs', 'zed_interfaces',
    'zed_msgs',
})  # fmt: skip
# The rooms that a dependency may enter; numpy may enter all, and what is not here none.
DEPENDENCIES = {
    'backports': frozenset({'io'}),  # zstd, as rosbags brings it
    'cdflib': frozenset({'datasets', 'simulation'}),
    'cv2': frozenset({'core', 'simulation', 'report', 'datasets', 'apps'}),
    'ezc3d': frozenset({'importing'}),
    'distributed': frozenset({'apps'}),
    'lz4': frozenset({'io'}),  # likewise
    'jinja2': frozenset({'report'}),
    'matplotlib': frozenset({'report'}),
    'plotly': frozenset({'report'}),
    'poselib': frozenset({'apps'}),
    'rich': frozenset({'apps'}),
    'rosbags': frozenset({'messages', 'io', 'apps'}),  # apps: the peer of bench_reading
    'scipy': frozenset({'apps', 'datasets', 'simulation'}),
    'yaml': frozenset({'io', 'datasets', 'simulation', 'report', 'ros', 'apps'}),
    'launch': frozenset({'launch'}),
    'launch_ros': frozenset({'launch'}),
    **dict.fromkeys(ROS_MODULES | DRIVER_MODULES, frozenset({'ros'})),
}


class Module(NamedTuple):
    """One source file of the package.

    Attributes:
        name: Dotted name.
        room: First folder or file below the package; '' for its own `__init__`.
        path: Where it stands.
        text: Its source.
        syntax: Its parsed source.

    """

    name: str
    room: str
    path: Path
    text: str
    syntax: ast.Module


Offence = tuple[int, str]
Rule = Callable[[Module], Iterator[Offence]]


def read_module(path: Path, root: Path) -> Module:
    """Parse a file of the tree under `root`."""
    parts = path.relative_to(root).with_suffix('').parts
    parts = parts[:-1] if parts[-1] == '__init__' else parts
    text = path.read_text()
    return Module('.'.join(parts), parts[1] if parts[1:] else '', path, text, ast.parse(text))


@pytest.fixture(scope='module')
def modules() -> list[Module]:
    """Parse every file of the package, once for all rules."""
    return [read_module(path, ROOT) for path in sorted((ROOT / PACKAGE).rglob('*.py'))]


def imports(module: Module) -> Iterator[tuple[int, str]]:
    """Yield line and dotted name of all that a module imports, wherever in the file it does."""
    for node in ast.walk(module.syntax):
        if isinstance(node, ast.Import):
            yield from ((node.lineno, alias.name) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = '.' * node.level + (node.module or '')
            yield from ((node.lineno, f'{base}.{alias.name}') for alias in node.names)
        elif isinstance(node, ast.Call) and ast.unparse(node.func) == 'importlib.import_module':
            yield from ((node.lineno, name) for name in literals(node.args))


def literals(nodes: list[ast.expr]) -> list[str]:
    """Return the strings that stand literally among some expressions."""
    return [n.value for n in nodes if isinstance(n, ast.Constant) and isinstance(n.value, str)]


def calls(module: Module) -> Iterator[tuple[ast.Call, str]]:
    """Yield the calls of a module with the dotted text of what is called."""
    for node in ast.walk(module.syntax):
        if isinstance(node, ast.Call):
            yield node, ast.unparse(node.func)


def imports_against_the_flow(module: Module) -> Iterator[Offence]:
    """Rooms import only what lies before them."""
    for line, name in imports(module):
        package, _, rest = name.partition('.')
        room = rest.split('.')[0]
        if package != PACKAGE or room not in ROOMS or room == module.room:
            continue
        if room not in ROOMS.get(module.room, frozenset()):
            yield line, f'{module.room or PACKAGE} imports {room}'
        needs_ros = module.room == 'apps' and module.name in ROS_PROGRAMS
        if room == 'ros' and not needs_ros and name.rpartition('.')[0] not in ROS_FREE:
            yield line, f'{module.name} runs without ROS, but imports {name}'


def needs_ros_after_all(module: Module) -> Iterator[Offence]:
    """What programs without ROS import of the room of ROS imports nothing that needs it."""
    for line, name in imports(module) if module.name in ROS_FREE else ():
        is_of_room = name.startswith(f'{PACKAGE}.ros.')
        if is_of_room and name.rpartition('.')[0] not in ROS_FREE:
            yield line, f'imports {name}'
        if name.split('.')[0] in ROS_MODULES | DRIVER_MODULES:
            yield line, f'imports {name}'


def imports_a_stranger(module: Module) -> Iterator[Offence]:
    """Dependencies enter the rooms that they are for, by their full name."""
    for line, name in imports(module):
        top = name.split('.')[0]
        if not top:
            yield line, f'relative import {name}'
            continue
        is_free = top in sys.stdlib_module_names | {PACKAGE, 'numpy'}
        if not is_free and module.room not in DEPENDENCIES.get(top, frozenset()):
            yield line, f'{module.room or PACKAGE} imports {top}'


def imports_a_private_name(module: Module) -> Iterator[Offence]:
    """A name with an underscore stays in its module."""
    for line, name in imports(module):
        last = name.rsplit('.', 1)[-1]
        if name.startswith(PACKAGE) and last.startswith('_') and not last.endswith('__'):
            yield line, f'imports {name}'


def hides_errors(module: Module) -> Iterator[Offence]:
    """Everything is caught at the edges only: ROS callbacks and a program's main."""
    if module.room == 'ros':
        return
    edge: set[ast.AST] = set()
    for node in ast.walk(module.syntax):
        if isinstance(node, ast.FunctionDef) and module.room == 'apps' and node.name == 'main':
            edge.update(ast.walk(node))
        if not isinstance(node, ast.ExceptHandler) or node in edge:
            continue
        caught = node.type.elts if isinstance(node.type, ast.Tuple) else [node.type]
        names = {ast.unparse(kind) if kind else 'everything' for kind in caught}
        last = node.body[-1]
        passes_on = isinstance(last, ast.Raise) and last.exc is None
        if names & {'Exception', 'BaseException', 'everything'} and not passes_on:
            yield node.lineno, f'catches {", ".join(sorted(names))}'


def prints(module: Module) -> Iterator[Offence]:
    """Only programs talk to the terminal."""
    if module.room != 'apps':
        yield from ((node.lineno, 'prints') for node, name in calls(module) if name == 'print')


def runs_what_it_reads(module: Module) -> Iterator[Offence]:
    """Input is data, never code; a command is a list, never a line for a shell."""
    for line, name in imports(module):
        if name == 'pickle' and module.name == PICKLE_READER:
            continue
        if name.split('.')[0] in {'pickle', 'marshal', 'shelve', 'dill', 'joblib'}:
            yield line, f'imports {name}'
    for node, name in calls(module):
        if name in {'eval', 'exec', 'os.system', 'os.popen', '__import__'}:
            yield node.lineno, f'calls {name}'
        if name.endswith('import_module') and not literals(node.args):
            yield node.lineno, f'calls {name} with a name that cannot be read here'
        for keyword in node.keywords:
            if keyword.arg in {'shell', 'allow_pickle'} and ast.unparse(keyword.value) != 'False':
                yield node.lineno, f'calls {name} with {keyword.arg}'


def is_long(module: Module) -> Iterator[Offence]:
    """Files and functions end before a reader's patience does."""
    n_lines = len(module.text.splitlines())
    if n_lines > MAX_FILE_LINES:
        yield n_lines, f'{n_lines} lines, at most {MAX_FILE_LINES}'
    for node in ast.walk(module.syntax):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            n_lines = (node.end_lineno or node.lineno) - node.lineno + 1
            if n_lines > MAX_FUNCTION_LINES:
                yield node.lineno, f'{node.name}: {n_lines} lines, at most {MAX_FUNCTION_LINES}'


def has_no_licence(module: Module) -> Iterator[Offence]:
    """Each file says under which licence it stands."""
    if not module.text.startswith(f'{SPDX}\n'):
        yield 1, f'does not begin with {SPDX!r}'


RULES: list[Rule] = [
    imports_against_the_flow,
    needs_ros_after_all,
    imports_a_stranger,
    imports_a_private_name,
    hides_errors,
    prints,
    runs_what_it_reads,
    is_long,
    has_no_licence,
]


@pytest.mark.threat('S1')
@pytest.mark.parametrize('rule', RULES)
def test_no_module_of_the_package_breaks_the_rule(rule: Rule, modules: list[Module]) -> None:
    """The whole package keeps it; the message names file, line and offence."""
    offences = [
        f'{module.path.relative_to(ROOT)}:{line}: {what}'
        for module in modules
        for line, what in rule(module)
    ]
    assert not offences, '\n'.join(offences)


def test_programs_and_tests_outside_the_package_name_their_licence() -> None:
    """Files that are not installed stand under the same licence."""
    paths = [ROOT / 'setup.py', *sorted((ROOT / 'test').rglob('*.py'))]
    unmarked = [path.name for path in paths if not path.read_text().startswith(f'{SPDX}\n')]
    assert not unmarked


def test_every_dependency_is_declared_for_rosdep(modules: list[Module]) -> None:
    """What the package imports, package.xml names by its rosdep key."""
    keys = {'cv2': 'python3-opencv', 'launch': 'ros2launch', 'launch_ros': 'ros2launch'}
    keys |= {name: f'python3-{name}' for name in ('matplotlib', 'numpy', 'rich', 'yaml')}
    # Of datasets, cluster, import, report and benchmark.
    optional = {'cdflib', 'distributed', 'ezc3d', 'jinja2', 'plotly', 'poselib', 'scipy'}
    without_key = {
        PACKAGE,
        'rosbags',
        'backports',
        'lz4',
        *optional,
        *DRIVER_MODULES,
        *sys.stdlib_module_names,
    }
    tops = {name.split('.')[0] for module in modules for _, name in imports(module)}
    used = {keys.get(top, top) for top in tops - without_key}
    declared = re.findall('<exec_depend>(.*)</exec_depend>', (ROOT / 'package.xml').read_text())
    assert used <= set(declared)


def test_every_room_is_known(modules: list[Module]) -> None:
    """A new folder or file below the package gets its place among the rooms first."""
    assert {module.room for module in modules} - {''} <= ROOMS.keys()


@pytest.mark.parametrize(
    ('rule', 'place', 'source'),
    [
        (imports_against_the_flow, 'core/a.py', 'from rpgd_ros.messages import decode_joints'),
        (imports_against_the_flow, 'core/a.py', 'def f():\n    from rpgd_ros import io'),
        (imports_against_the_flow, 'io/a.py', 'import rpgd_ros.session'),
        (imports_against_the_flow, 'ros/a.py', 'from rpgd_ros.report import html'),
        (imports_against_the_flow, '__init__.py', 'from rpgd_ros.core import calibrate'),
        (imports_against_the_flow, 'apps/simulate.py', 'from rpgd_ros.ros.node import run'),
        (needs_ros_after_all, 'ros/setup.py', 'from rpgd_ros.ros.declare import declare'),
        (needs_ros_after_all, 'ros/settings.py', 'def f():\n    import rclpy'),
        (imports_a_stranger, 'session.py', 'import rclpy.node'),
        (imports_a_stranger, 'apps/a.py', 'from sensor_msgs.msg import PointCloud2'),
        (imports_a_stranger, 'core/a.py', 'import scipy'),
        (imports_a_stranger, 'core/a.py', 'from . import geometry'),
        (imports_a_stranger, 'session.py', 'from rosbags.highlevel import AnyReader'),
        (imports_a_stranger, 'session.py', "import importlib\nimportlib.import_module('rclpy')"),
        (imports_a_private_name, 'io/a.py', 'from rpgd_ros.core.camera import _fold_radius'),
        (hides_errors, 'io/a.py', 'try:\n    f()\nexcept Exception:\n    pass'),
        (hides_errors, 'io/a.py', 'try:\n    f()\nexcept (OSError, Exception):\n    g()'),
        (hides_errors, 'apps/a.py', 'def f():\n  try:\n    f()\n  except:\n    pass'),
        (prints, 'io/a.py', 'print(1)'),
        (runs_what_it_reads, 'io/a.py', 'from pickle import load'),
        (runs_what_it_reads, 'datasets/aistpp.py', 'import pickle'),
        (runs_what_it_reads, 'datasets/pickles.py', 'from pickle import loads'),
        (runs_what_it_reads, 'io/a.py', "eval('1')"),
        (runs_what_it_reads, 'ros/a.py', 'importlib.import_module(name)'),
        (runs_what_it_reads, 'io/a.py', "subprocess.run('ls', shell=True)"),
        (runs_what_it_reads, 'io/a.py', "numpy.load('a.npy', allow_pickle=True)"),
        (is_long, 'io/a.py', 'pass\n' * (MAX_FILE_LINES + 1)),
        (is_long, 'io/a.py', 'def f():\n' + '    pass\n' * MAX_FUNCTION_LINES),
        (has_no_licence, 'io/a.py', 'import math'),
    ],
)
def test_a_rule_sees_its_offence(tmp_path: Path, rule: Rule, place: str, source: str) -> None:
    """Each rule finds what it is there for, so that its silence means something."""
    path = tmp_path / PACKAGE / place
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(source)
    assert list(rule(read_module(path, tmp_path)))


@pytest.mark.parametrize(
    ('rule', 'place', 'source'),
    [
        (imports_against_the_flow, 'apps/calibrator.py', 'from rpgd_ros.ros.node import run'),
        (imports_against_the_flow, 'io/rig.py', 'from rpgd_ros.core import Camera'),
        (imports_against_the_flow, 'apps/a.py', 'from rpgd_ros.ros.setup import read_setup'),
        (needs_ros_after_all, 'ros/node.py', 'import rclpy'),
        (imports_a_stranger, 'ros/node.py', 'import rclpy, numpy as np, threading'),
        (hides_errors, 'io/a.py', 'try:\n    f()\nexcept BaseException:\n    g()\n    raise'),
        (hides_errors, 'apps/a.py', 'def main():\n  try:\n    f()\n  except Exception:\n    g()'),
        (hides_errors, 'io/a.py', 'try:\n    f()\nexcept OSError:\n    pass'),
        (prints, 'apps/a.py', 'print(1)'),
        (runs_what_it_reads, 'io/a.py', "numpy.load('a.npy', allow_pickle=False)"),
        (runs_what_it_reads, 'datasets/pickles.py', 'import pickle'),
    ],
)
def test_a_rule_lets_pass_what_is_right(
    tmp_path: Path, rule: Rule, place: str, source: str
) -> None:
    """The edges of the rules lie where DESIGN says."""
    path = tmp_path / PACKAGE / place
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(source)
    assert not list(rule(read_module(path, tmp_path)))
