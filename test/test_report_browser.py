# SPDX-License-Identifier: Apache-2.0
"""The page in a real browser: it opens, draws, turns, copies and prints, and asks for nothing."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import cv2
import numpy as np
import pytest
import report_cases
from numpy.typing import NDArray

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

pytest.importorskip('plotly')
pytest.importorskip('jinja2')
playwright = pytest.importorskip('playwright.sync_api')
CHROMIUM = shutil.which('chromium') or shutil.which('google-chrome')
pytestmark = pytest.mark.skipif(CHROMIUM is None, reason='needs chromium')

# WebGL by the processor: test machines have no graphics.
FLAGS = ('--no-sandbox', '--use-gl=angle', '--use-angle=swiftshader', '--ignore-gpu-blocklist',
         '--enable-unsafe-swiftshader')  # fmt: skip
WIDTHS = (360, 768, 1280)
A4_PX = 703  # of A4 within the margins of the page
Image = NDArray[np.uint8]


class Opened(NamedTuple):
    """A page and what happened while it was open.

    Attributes:
        page: The browser's tab.
        trouble: Errors and requests.

    """

    page: Page
    trouble: list[str]


@pytest.fixture(scope='module')
def browser() -> Iterator[Browser]:
    """Start one browser for all."""
    with playwright.sync_playwright() as started:
        browser = started.chromium.launch(executable_path=CHROMIUM, args=list(FLAGS))
        yield browser
        browser.close()


@pytest.fixture(scope='module')
def report(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Make the page of a walk before a moved camera: it has every kind of block."""
    folder = tmp_path_factory.mktemp('walk')
    report_cases.bumped(folder)
    made = report_cases.run_on(folder, lambda: '{}')
    assert made.code == 0
    return made.page


@pytest.fixture(scope='module')
def opened(browser: Browser, report: Path) -> Iterator[Callable[..., Opened]]:
    """Return a function that opens the page in a window of some width and theme.

    One window of each kind for all tests; `fresh` for those that leave it changed.
    """
    kept: dict[tuple[int, Any], Opened] = {}
    contexts = []

    def opened(*, width: int = 1280, theme: Any = 'light', fresh: bool = False) -> Opened:
        if not fresh and (width, theme) in kept:
            return kept[width, theme]
        context = browser.new_context(
            viewport={'width': width, 'height': 900},
            color_scheme=theme,
            permissions=['clipboard-read', 'clipboard-write'],
        )
        contexts.append(context)
        page = context.new_page()
        trouble: list[str] = []
        page.on('pageerror', lambda error: trouble.append(str(error)))
        page.on(
            'console',
            lambda m: trouble.append(m.text) if m.type == 'error' else None,
        )
        page.on(
            'request',
            lambda r: trouble.append(r.url[:99]) if r.url.startswith(('http', 'ws')) else None,
        )
        page.goto(report.as_uri())
        page.wait_for_function("document.documentElement.dataset.ready === 'yes'")
        if not fresh:
            kept[width, theme] = Opened(page, trouble)
        return Opened(page, trouble)

    yield opened
    for context in contexts:
        context.close()


def draw_all(page: Page) -> int:
    """Scroll to every figure until it is drawn; return how many there are."""
    plots = page.locator('.plot')
    for i in range(plots.count()):
        plots.nth(i).scroll_into_view_if_needed()
        plots.nth(i).locator('.main-svg').first.wait_for(state='attached')
    return plots.count()


def picture(page: Page, selector: str) -> Image:
    """Take a picture of a part of the page."""
    data = page.locator(selector).screenshot()
    image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
    assert image is not None
    return np.asarray(image, np.uint8)


@pytest.mark.parametrize('width', WIDTHS)
def test_it_opens_in_every_width_and_theme_without_errors_or_requests(
    opened: Callable[..., Opened], width: int
) -> None:
    """All figures are drawn, nothing sticks out, and the ground has the theme's colour."""
    theme = 'dark' if width == WIDTHS[1] else 'light'
    page, trouble = opened(width=width, theme=theme)
    assert draw_all(page) > 15
    for _ in range(2):
        assert page.evaluate('document.documentElement.scrollWidth') <= width
        assert page.evaluate('document.documentElement.dataset.theme') == theme
        ground = page.evaluate('getComputedStyle(document.body).backgroundColor')
        brightness = np.mean([int(n) for n in ground.removeprefix('rgb(').rstrip(')').split(',')])
        assert (brightness > 200) == (theme == 'light')
        page.locator('#theme').click()
        theme = 'light' if theme == 'dark' else 'dark'
    assert trouble == []


def test_the_library_takes_every_figure_as_it_was_meant(opened: Callable[..., Opened]) -> None:
    """No trace and no layout has a key or value that Plotly does not know."""
    page, _ = opened()
    complaints = page.evaluate("""() => {
        const colour = (v) => JSON.parse(JSON.stringify(v).replace(/"@[a-z]+"/g, '"#123456"'));
        return [...document.querySelectorAll('script[data-figure]')].flatMap((script) => {
            const f = colour(JSON.parse(script.textContent));
            return (Plotly.validate(f.data, f.layout) ?? []).map((c) => c.msg);
        });
    }""")
    assert complaints == []


def test_the_room_is_drawn_in_space_and_turns_with_the_mouse(
    opened: Callable[..., Opened],
) -> None:
    """The picture has many colours, and another one after a drag."""
    page, trouble = opened()
    room = page.locator('#room-3d')
    room.scroll_into_view_if_needed()
    page.wait_for_selector('#room-3d canvas')
    page.wait_for_timeout(800)
    before = picture(page, '#room-3d')
    assert len(np.unique(before.reshape(-1, 3), axis=0)) > 50
    box = room.bounding_box()
    assert box is not None
    x, y = box['x'] + box['width'] / 2, box['y'] + box['height'] / 2
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x + 120, y + 30, steps=8)
    page.mouse.up()
    page.wait_for_timeout(1000)
    after = picture(page, '#room-3d')
    assert np.mean(np.abs(before.astype(int) - after) > 20) > 0.01
    assert trouble == []


def test_every_copy_button_copies_what_stands_below_it(opened: Callable[..., Opened]) -> None:
    """Whole, and says that it did."""
    page, _ = opened()
    boxes = page.locator('.code')
    assert boxes.count() == 6
    for i in range(boxes.count()):
        button = boxes.nth(i).locator('button')
        button.click()
        button.filter(has_text='Copied').wait_for()
        text = boxes.nth(i).locator('pre').text_content()
        assert page.evaluate('navigator.clipboard.readText()') == text


def test_without_the_clipboard_of_the_browser_the_older_way_copies(
    opened: Callable[..., Opened],
) -> None:
    """Pages from a disk may not use it everywhere."""
    page, _ = opened(fresh=True)
    page.evaluate("""() => {
        Object.defineProperty(navigator.clipboard, 'writeText', {
            value: () => Promise.reject(new Error('not allowed')),
        });
    }""")
    page.locator('.code button').first.click()
    page.locator('.code button').first.filter(has_text='Copied').wait_for()
    text = page.locator('.code pre').first.text_content()
    assert page.evaluate('navigator.clipboard.readText()') == text


def test_the_button_changes_the_theme_of_text_and_figures(opened: Callable[..., Opened]) -> None:
    """And back."""
    page, _ = opened(theme='light')
    page.locator('#joint-residuals').scroll_into_view_if_needed()
    page.locator('#joint-residuals .main-svg').first.wait_for()
    colour = "document.getElementById('joint-residuals')._fullLayout.font.color"
    light = page.evaluate(colour)
    page.locator('#theme').click()
    page.wait_for_function(f'{colour} !== "{light}"')
    assert page.evaluate('document.documentElement.dataset.theme') == 'dark'
    page.locator('#theme').click()
    page.wait_for_function(f'{colour} === "{light}"')


def test_it_prints_with_all_figures(opened: Callable[..., Opened], tmp_path: Path) -> None:
    """Also those that nobody has scrolled to, on a light ground, and as wide as the paper.

    Drawn for the screen's width, the last bar of a histogram would be cut.
    """
    page, trouble = opened(width=1280, theme='dark', fresh=True)
    page.evaluate("dispatchEvent(new Event('beforeprint'))")
    page.emulate_media(media='print')
    wide = page.evaluate("""() => [...document.querySelectorAll('.plot')].map((plot) =>
        [plot.getBoundingClientRect(), plot.querySelector('.main-svg').getBoundingClientRect()]
        .map((box) => [box.left, box.right]).flat())""")
    assert np.abs(np.diff(np.array(wide).reshape(-1, 2, 2), axis=1)).max() < 1.0
    assert np.ptp(np.array(wide)) <= A4_PX
    assert page.evaluate('document.documentElement.dataset.theme') == 'light'
    page.emulate_media(media='screen')
    page.evaluate("dispatchEvent(new Event('afterprint'))")
    page.pdf(path=str(tmp_path / 'report.pdf'), print_background=True)
    drawn = page.evaluate(
        "document.querySelectorAll('.plot .main-svg').length > 0 && "
        "[...document.querySelectorAll('.plot')].every(p => p._fullLayout)"
    )
    assert drawn
    assert (tmp_path / 'report.pdf').stat().st_size > 50_000
    assert trouble == []
