"""The page of the signal database in a real browser: what is read, clicked and typed, by whom, at which width."""

# ruff: noqa: E402

from __future__ import annotations

import json
import shutil
import sys
import time
from collections.abc import Callable, Iterator
from datetime import datetime, timedelta, timezone
from pathlib import Path
from typing import Any

import pytest

sys.path.insert(0, str(Path(__file__).parent / "support"))

from sopdb_server import Running, body, database, serving

for _module in ("selenium", "fastapi", "uvicorn", "sqlalchemy", "alembic", "httpx"):
    pytest.importorskip(_module)
if shutil.which("chromium") is None or shutil.which("chromedriver") is None:
    pytest.skip("chromium and chromedriver are not installed", allow_module_level=True)

from selenium import webdriver
from selenium.webdriver.common.by import By
from selenium.webdriver.common.keys import Keys
from selenium.webdriver.remote.webelement import WebElement

from soopnav_cpp.sopdb.contributing import Contributor
from soopnav_cpp.sopdb.records import Characterization

pytestmark = pytest.mark.example

HOSTILE = (
    "<img src=x onerror=window.hacked=1>",
    '"><script>window.hacked=1</script>',
    "'; DROP TABLE sources; --",
    "{{7*7}} ${7*7} %s",
    "\u05d0\u05d1 \u202f&lt;b&gt;",
)
KINDS = ("cdma", "lte", "fm", "gps", "iridium", "ofdm", "other")
SOURCES = 60 + len(HOSTILE)


def seed(store: Any) -> None:
    who = [Contributor(f"receiver-{k}") for k in range(3)]
    for i in range(60):
        kind = KINDS[i % len(KINDS)]
        place = None if kind in ("gps", "iridium") else (60.0 + 0.01 * (i % 8), 24.5 + 0.05 * (i // 8))
        one = body(f"{kind} {i:02d}", kind, carrier_hz=90e6 + 1e6 * i, place_deg=place, age_s=60.0 * (i + 1),
                   noise=None if i % 10 == 9 else (1e-23, 1e-25))  # fmt: skip
        assert store.contribute(Characterization.model_validate(one), who[0]).result().answer["status"] == "accepted"
    for i, name in enumerate(HOSTILE):
        one = body(name, "other", carrier_hz=400e6 + 1e6 * i, place_deg=(60.3, 24.5 + 0.02 * i))
        assert store.contribute(Characterization.model_validate(one), who[1]).result().answer["status"] == "accepted"


class Page:
    """A browser's window on a service."""

    def __init__(self, driver: webdriver.Chrome) -> None:
        self.driver = driver

    def open(self, url: str, width: int = 1600, height: int = 1000) -> None:
        self.driver.get_log("browser")
        self.driver.get_log("performance")
        self.width(width, height)
        self.driver.get("about:blank")
        self.driver.get(url)

    def width(self, width: int, height: int) -> None:
        metrics = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False}
        self.driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", metrics)

    def js(self, script: str, *arguments: Any) -> Any:
        return self.driver.execute_script(script, *arguments)

    def all(self, css: str) -> list[WebElement]:
        return self.driver.find_elements(By.CSS_SELECTOR, css)

    def one(self, css: str) -> WebElement:
        return self.driver.find_element(By.CSS_SELECTOR, css)

    def text(self, css: str) -> str:
        return str(self.js("return document.querySelector(arguments[0])?.textContent ?? ''", css))

    def names(self) -> list[str]:
        return list(self.js("return [...document.querySelectorAll('#rows th')].map((cell) => cell.textContent)"))

    def click(self, css: str) -> None:
        self.one(css).click()

    def press(self, *keys: str) -> None:
        for key in keys:
            self.driver.switch_to.active_element.send_keys(key)

    def focused(self, property: str) -> str:
        return str(self.js(f"return document.activeElement.{property}"))

    def wait(self, condition: Callable[[], Any], what: str) -> Any:
        end = time.monotonic() + 10.0
        while not (value := condition()):
            if time.monotonic() > end:
                raise AssertionError(f"never: {what}; banner {self.text('#banner')!r}; {self.complaints()}")
            time.sleep(0.02)
        return value

    def wait_rows(self, count: int) -> None:
        self.wait(lambda: len(self.names()) == count and self.ready(), f"{count} rows, are {len(self.names())}")

    def ready(self) -> bool:
        return self.js("return !document.querySelector('#sources').hasAttribute('aria-busy')") is True

    def complaints(self) -> list[str]:
        return [entry["message"] for entry in self.driver.get_log("browser") if entry["level"] == "SEVERE"]


@pytest.fixture(scope="module")
def driver(tmp_path_factory: pytest.TempPathFactory) -> Iterator[webdriver.Chrome]:
    options = webdriver.ChromeOptions()
    options.binary_location = str(shutil.which("chromium"))
    profile = tmp_path_factory.mktemp("chromium")
    arguments = [
        "--headless=new",
        "--no-sandbox",
        "--disable-dev-shm-usage",
        "--disable-gpu",
        "--no-first-run",
        "--disable-background-networking",
        "--force-prefers-reduced-motion",  # colours change at once
        f"--user-data-dir={profile}",
    ]
    for argument in arguments:
        options.add_argument(argument)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    browser = webdriver.Chrome(options=options, service=webdriver.ChromeService(shutil.which("chromedriver")))
    browser.set_script_timeout(10)
    yield browser
    browser.quit()


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Running]:
    with database(tmp_path_factory.mktemp("page"), public_read=True) as running:
        seed(running.store)
        yield running


@pytest.fixture
def page(driver: webdriver.Chrome, service: Running) -> Page:
    page = Page(driver)
    page.open(service.url)
    page.wait_rows(50)
    return page


def test_table_and_map_agree_and_nothing_is_fetched_elsewhere(page: Page, service: Running) -> None:
    positioned = page.js("return [...document.querySelectorAll('#rows tr')].map((row) => row.dataset.id).sort().join()")
    marked = page.js("return [...document.querySelectorAll('.marker')].map((m) => m.dataset.id).sort().join()")
    without = [name for name in page.names() if name.startswith(("gps", "iridium"))]
    assert len(set(marked.split(","))) == 50 - len(without)
    assert set(marked.split(",")) < set(positioned.split(","))
    assert f"{len(without)} of 50 without a known position" in page.text(".mapnote")
    inside = """const box = document.querySelector('#map').getBoundingClientRect();
        return [...document.querySelectorAll('.marker')].every((m) => { const r = m.getBoundingClientRect();
            return r.left > box.left && r.right < box.right && r.top > box.top && r.bottom < box.bottom; })"""
    page.wait(lambda: page.js(inside), "every marker within the map")
    # West is left and north is up: the markers lie in the order of the places that the service gives.
    order = """const of = (id) => document.querySelector(`.marker[data-id="${id}"]`).getBoundingClientRect();
        return fetch('v1/sources?limit=50').then((r) => r.json()).then((a) => a.sources.filter((s) => s.position)
            .map((s) => [s.position.longitude_deg, s.position.latitude_deg, of(s.id).x, of(s.id).y]))"""
    placed = page.js(order)
    east, west = max(placed), min(placed)
    assert east[2] > west[2] + 50
    north, south = max(placed, key=lambda p: p[1]), min(placed, key=lambda p: p[1])
    assert north[3] < south[3] - 50
    page.click("#rows button")
    page.wait(lambda: page.all("svg.allan"), "the plot")
    urls = [
        message["params"]["request"]["url"]
        for message in (json.loads(entry["message"])["message"] for entry in page.driver.get_log("performance"))
        if message["method"] == "Network.requestWillBeSent"
    ]
    assert len(urls) > 8
    assert [url for url in urls if not url.startswith((service.url, "about:", "data:image/"))] == []
    assert page.complaints() == []


def test_keyboard_alone_walks_to_a_plot_and_back(page: Page) -> None:
    page.press(Keys.TAB)
    assert page.focused("className") == "skip"
    page.press(Keys.ENTER)
    page.wait(lambda: page.focused("id") == "sources", "the skip link's target")
    for _ in range(12):
        page.press(Keys.TAB)
        if page.focused("closest('#rows')") != "None":
            break
    first = page.focused("textContent")
    assert first == page.names()[0]
    page.press(Keys.ARROW_DOWN, Keys.ARROW_DOWN)
    assert page.focused("textContent") == page.names()[2]
    page.press(Keys.END)
    assert page.focused("textContent") == page.names()[-1]
    page.press(Keys.HOME, Keys.ARROW_DOWN)
    name = page.focused("textContent")
    page.press(Keys.ENTER)
    page.wait(lambda: page.focused("id") == "detail-title", "the panel's heading")
    assert page.focused("textContent") == name
    for _ in range(6):
        page.press(Keys.TAB)
        if page.focused("classList") == "['allan']" or "allan" in page.focused("getAttribute('class')"):
            break
    assert "Allan deviation of" in page.focused("getAttribute('aria-label')")
    assert page.js("return getComputedStyle(document.activeElement).outlineStyle") != "none"
    page.press(Keys.ARROW_RIGHT, Keys.ARROW_RIGHT)
    assert page.text(".readout").startswith("τ = ")
    assert "95 %" in page.text(".readout")
    page.press(Keys.ESCAPE)
    page.wait(lambda: page.focused("textContent") == name, "the focus back on the row")
    assert not page.one("#detail").is_displayed()
    assert page.complaints() == []


@pytest.mark.slow
def test_keyboard_on_the_map(page: Page) -> None:
    page.js("document.querySelector('#map svg').focus()")
    before = page.js("return document.querySelector('.marker').getAttribute('transform')")
    page.press(Keys.ARROW_RIGHT)
    page.wait(lambda: page.js("return document.querySelector('.marker').getAttribute('transform')") != before, "a pan")
    page.press("+", "-", "0", Keys.ENTER)
    page.wait(lambda: "marker" in page.focused("getAttribute('class')"), "the focus on a marker")
    first = page.focused("dataset.id")
    at = page.js("return document.activeElement.getBoundingClientRect().x")
    page.press(Keys.ARROW_LEFT)
    assert page.focused("dataset.id") != first
    assert page.js("return document.activeElement.getBoundingClientRect().x") < at
    page.press(Keys.ENTER)
    page.wait(lambda: page.focused("id") == "detail-title", "the panel")
    page.press(Keys.ESCAPE)
    page.wait(lambda: "marker" in page.focused("getAttribute('class')"), "the focus back on the marker")


@pytest.mark.slow
def test_filters(page: Page) -> None:
    page.js("const s = document.querySelector('#filter-kind'); s.value = 'fm'; s.dispatchEvent(new Event('change'))")
    page.wait(lambda: {name[:2] for name in page.names()} == {"fm"}, "FM stations alone")
    assert len(page.all(".marker")) == len(page.names())
    assert "match the filter" in page.text("#summary")
    page.click("#filter-clear")
    page.wait_rows(50)
    page.one("#filter-near").send_keys("north pole", Keys.ENTER)
    page.wait(lambda: "latitude and a longitude" in page.text("#near-problem"), "a sentence about the place")
    assert page.focused("id") == "filter-near"
    assert page.one("#filter-near").get_attribute("aria-invalid") == "true"
    page.one("#filter-near").clear()
    page.one("#filter-radius").clear()
    page.one("#filter-radius").send_keys("3")
    page.one("#filter-near").send_keys("60.3, 24.5", Keys.ENTER)
    page.wait(lambda: 0 < len(page.names()) <= len(HOSTILE) and page.ready(), "the near ones")
    assert page.names()
    assert page.text("#near-problem") == ""
    page.one("#filter-near").clear()
    page.one("#filter-near").send_keys("-60, -150", Keys.ENTER)
    page.wait(lambda: "No source matches the filter." in page.text("#empty"), "the empty state")
    page.click("#empty button")
    page.wait_rows(50)


@pytest.mark.slow
def test_name_filter(page: Page) -> None:
    page.one("#filter-name").send_keys("CDMA 1", Keys.ENTER)
    page.wait(lambda: page.names() and all(name.startswith("cdma 1") for name in page.names()), "names with cdma 1")
    page.one("#filter-name").clear()
    page.one("#filter-name").send_keys("%_\\", Keys.ENTER)
    page.wait(lambda: "No source matches" in page.text("#empty"), "no wildcard")


@pytest.mark.slow
def test_area_of_the_map(page: Page) -> None:
    page.js("document.querySelector('#map svg').focus()")
    drawn = "return [...document.querySelectorAll('.marker')].map((m) => m.getAttribute('transform')).join()"
    for _ in range(2):
        before = page.js(drawn)
        page.press("+")
        page.wait(lambda: page.js(drawn) != before, "the map drawn nearer")  # noqa: B023
    seen = """const box = document.querySelector('#map').getBoundingClientRect();
        return [...document.querySelectorAll('.marker')].filter((m) => { const r = m.getBoundingClientRect();
            const x = (r.left + r.right) / 2, y = (r.top + r.bottom) / 2;
            return x > box.left && x < box.right && y > box.top && y < box.bottom; }).length"""
    expected = page.js(seen)
    assert 0 < expected < 30
    page.click("#filter-area")
    page.wait(lambda: page.one("#filter-area").get_attribute("aria-pressed") == "true" and page.ready(), "the filter")
    assert len(page.names()) >= expected
    assert page.js(seen) == len(page.names()) == len(page.all(".marker"))
    page.click("#filter-area")
    page.wait_rows(50)


@pytest.mark.slow
def test_sorting_and_paging(page: Page) -> None:
    first = set(page.names())
    page.click("#next")
    page.wait_rows(SOURCES - 50)
    assert not first & set(page.names())
    assert len(first | set(page.names())) == SOURCES
    assert not page.one("#next").is_enabled()
    page.click("#previous")
    page.wait_rows(50)
    assert set(page.names()) == first
    column = """const [index, clicks] = arguments; const th = document.querySelectorAll('#headings th')[index];
        for (let i = 0; i < clicks; i += 1) th.querySelector('button').click();
        return [th.getAttribute('aria-sort'), [...document.querySelectorAll(`#rows tr > :nth-child(${index + 1})`)]
            .map((cell) => cell.textContent)]"""
    for index in range(8):
        assert page.js(column, index, 1 if index else 2)[0] == "ascending"
        state, cells = page.js(column, index, 1)
        assert state == "descending"
        again, back = page.js(column, index, 1)
        assert again == "ascending"
        assert sorted(cells) == sorted(back)
        assert cells != back or len(set(cells)) == 1
        if index == 2:
            assert [float(x.split()[0]) for x in back] == sorted(float(x.split()[0]) for x in cells)
        if index == 0:
            assert back == sorted(back)


def test_hostile_names_are_text(page: Page) -> None:
    page.click("#next")
    page.wait_rows(SOURCES - 50)
    assert set(HOSTILE) <= set(page.names())
    for name in HOSTILE[:2]:
        find = "[...document.querySelectorAll('#rows button')].find((b) => b.textContent === arguments[0])"
        page.js(f"{find}.click()", name)
        page.wait(lambda: page.text("#detail-title") == name, "the panel")  # noqa: B023
        page.wait(lambda: page.all("svg.allan"), "the plot")
    assert page.js("return window.hacked") is None
    assert page.all("#page-sources :is(img, script, b)") == []
    assert page.complaints() == []


@pytest.mark.slow
def test_a_link_opens_a_source_and_a_bad_one_says_so(page: Page, service: Running) -> None:
    identity = page.js("return document.querySelector('#rows tr').dataset.id")
    page.open(f"{service.url}/#source/{identity}")
    page.wait(lambda: page.text("#detail-title") and page.all("#clock-time"), "the panel of the link")
    page.js("const t = document.querySelector('#clock-time'); t.value = arguments[0]",
            (datetime.now(timezone.utc) + timedelta(hours=5)).strftime("%Y-%m-%dT%H:%M:%S"))  # fmt: skip
    before = page.text("#detail .facts:nth-of-type(1)")
    sigma = page.text("#detail")
    page.click("#detail .when button")
    page.wait(lambda: page.text("#detail") != sigma, "the clock five hours on")
    assert before is not None
    assert page.text(".when button[type=button]") == "Now"
    page.open(f"{service.url}/#source/987654321")
    page.wait(lambda: "does not know this source" in page.text("#banner"), "a sentence")
    for nonsense in ("#source/%E0%A4%A", "#source/../../etc", "#what"):
        page.open(f"{service.url}/{nonsense}")
        page.wait_rows(50)
        assert not page.one("#detail").is_displayed()


CONTRAST = """
const canvas = document.createElement('canvas').getContext('2d', { willReadFrequently: true });
const rgba = (text) => { canvas.clearRect(0, 0, 1, 1); canvas.fillStyle = text; canvas.fillRect(0, 0, 1, 1);
    const d = canvas.getImageData(0, 0, 1, 1).data; return [d[0], d[1], d[2], d[3] / 255]; };
const over = (top, under) => [0, 1, 2].map((i) => top[i] * top[3] + under[i] * (1 - top[3])).concat(1);
const ground = (node) => { const c = node ? rgba(getComputedStyle(node).backgroundColor) : [255, 255, 255, 1];
    return c[3] === 1 ? c : over(c, ground(node.parentElement)); };
const light = (c) => { const f = c.slice(0, 3).map((v) => v / 255).map((v) =>
    v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4); return 0.2126 * f[0] + 0.7152 * f[1] + 0.0722 * f[2]; };
const poor = []; let seen = 0;
const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
while (walker.nextNode()) {
  const node = walker.currentNode.parentElement;
  if (!walker.currentNode.textContent.trim() || !node.checkVisibility()) continue;
  if (node.closest('button:disabled, option, title, noscript, .visually-hidden, .skip, script, style')) continue;
  const style = getComputedStyle(node);
  const svg = node instanceof SVGElement;
  const colour = rgba(svg ? style.fill : style.color);
  const back = ground(svg ? node.closest('svg') : node);
  const [a, b] = [light(over(colour, back)), light(back)];
  const ratio = (Math.max(a, b) + 0.05) / (Math.min(a, b) + 0.05);
  seen += 1;
  if (ratio < 4.5) poor.push([ratio, walker.currentNode.textContent.trim().slice(0, 40), node.outerHTML.slice(0, 80)]);
}
return [seen, poor];
"""

NAMELESS = """
const bad = [];
const ids = [...document.querySelectorAll('[id]')].map((node) => node.id);
if (new Set(ids).size !== ids.length) bad.push('an id twice');
for (const name of ['aria-labelledby', 'aria-describedby', 'for'])
  for (const node of document.querySelectorAll(`[${name}]`))
    for (const id of node.getAttribute(name).split(' '))
      if (!document.getElementById(id) && node.checkVisibility()) bad.push(`${name} of nothing: ${id}`);
if (!document.documentElement.lang || !document.title) bad.push('no language or title');
if (document.querySelectorAll('h1').length !== 1) bad.push('not one h1');
let level = 1;
for (const node of document.querySelectorAll('h1, h2, h3, h4')) {
  if (!node.checkVisibility()) continue;
  const own = Number(node.tagName[1]);
  if (own > level + 1) bad.push(`a heading skips a level: ${node.textContent}`);
  level = own;
}
if ([...document.querySelectorAll('main')].filter((node) => node.checkVisibility()).length !== 1) bad.push('mains');
for (const node of document.querySelectorAll('[tabindex]')) if (node.tabIndex > 0) bad.push('a tabindex above zero');
for (const node of document.querySelectorAll('button, input, select')) {
  const box = node.getBoundingClientRect();
  if (!node.checkVisibility()) continue;
  if (box.width < 24 || box.height < 24) bad.push(`small target: ${node.outerHTML.slice(0, 80)}`);
}
for (const node of document.querySelectorAll('[style]'))
  if (!node.closest('.scalebar')) bad.push(`a style in the markup: ${node.outerHTML.slice(0, 80)}`);
return bad;
"""

INTERACTIVE = {"button", "link", "textbox", "searchbox", "combobox", "spinbutton", "application", "image", "DateTime"}


@pytest.mark.parametrize("theme", ["light", pytest.param("dark", marks=pytest.mark.slow)])
def test_contrast_labels_and_targets(page: Page, theme: str) -> None:
    page.js("document.documentElement.dataset.theme = arguments[0]", theme)
    page.one("#filter-near").send_keys("nowhere", Keys.ENTER)
    page.click("#rows button")
    page.wait(lambda: page.all("svg.allan"), "the plot")
    page.click("#detail summary")
    seen, poor = page.js(CONTRAST)
    assert seen > 200
    assert poor == []
    assert page.js(NAMELESS) == []
    page.driver.execute_cdp_cmd("Accessibility.enable", {})
    nodes = page.driver.execute_cdp_cmd("Accessibility.getFullAXTree", {})["nodes"]
    roles = [(n["role"]["value"], n.get("name", {}).get("value", "")) for n in nodes if not n.get("ignored")]
    assert len([role for role, _ in roles if role in INTERACTIVE]) > 100
    assert [role for role, name in roles if role in INTERACTIVE and not name.strip()] == []
    assert ("application", "Map of the sources") in roles


@pytest.mark.slow
def test_no_page_is_wider_than_its_window(page: Page) -> None:
    page.click("#rows button")
    page.wait(lambda: page.all("svg.allan"), "the plot")
    page.click("#detail summary")
    inside = """const box = document.querySelector('#detail').getBoundingClientRect();
        return [...document.querySelectorAll('#detail *')].filter((n) => n.checkVisibility()
            && n.getBoundingClientRect().right > box.right + 1).map((n) => n.outerHTML.slice(0, 80))"""
    for width in (320, 360, 700, 1100, 2200):
        page.width(width, 740)
        assert page.js("return document.documentElement.scrollWidth - window.innerWidth") <= 0, width
        assert page.js(inside) == [], width
        table = "return document.querySelector('#table').scrollWidth - document.querySelector('.list').clientWidth"
        assert page.js(table) <= 0, width
    page.width(360, 740)
    page.press(Keys.ESCAPE)
    page.click("#rows button")
    page.wait(lambda: page.focused("id") == "detail-title", "the panel")
    top = page.js("return document.querySelector('#detail').getBoundingClientRect().top")
    assert -1 <= top < 100
    page.click("#tab-admin")
    assert page.js("return document.documentElement.scrollWidth - window.innerWidth") <= 0


@pytest.mark.slow
def test_empty_database(driver: webdriver.Chrome, tmp_path: Path) -> None:
    page = Page(driver)
    with database(tmp_path, public_read=True) as running:
        page.open(running.url)
        page.wait(lambda: "No source is known yet." in page.text("#empty"), "the sentence")
        assert "soopnav sopdb push" in page.text("#empty")
        assert page.complaints() == []


def enter_token(page: Page, text: str) -> None:
    page.click("#token-button")
    page.wait(lambda: page.focused("id") == "token-input", "the dialog")
    page.one("#token-input").send_keys(text, Keys.ENTER)


@pytest.mark.slow
def test_tokens_quarantine_and_limits(driver: webdriver.Chrome, tmp_path: Path) -> None:
    page = Page(driver)
    with database(tmp_path) as running:
        store, tokens = running.store, running.tokens
        good = body("Tower 1", receiver="roof")
        store.contribute(Characterization.model_validate(good), Contributor("a")).result()
        liar = body("Tower 1", receiver="<i>liar</i>", bias_s=0.4)
        assert store.contribute(Characterization.model_validate(liar), Contributor("b")).result().answer["status"] == (
            "quarantined"
        )
        page.open(running.url)
        page.wait(lambda: "only with a token" in page.text("#banner"), "asked for a token")
        assert page.names() == []
        enter_token(page, "two words")
        page.wait(lambda: "one word" in page.text("#token-problem"), "the rule")
        page.press(Keys.ESCAPE)
        enter_token(page, "sop_" + "a" * 10 + "_" + "b" * 43)
        page.wait(lambda: "refused" in page.text("#banner"), "the refusal")
        enter_token(page, tokens["read"])
        page.wait_rows(1)
        assert not page.one("#banner").is_displayed()
        assert page.js("return localStorage.length === 0 || !JSON.stringify(localStorage).includes('sop_')")
        assert tokens["read"] not in page.js(
            "return document.documentElement.outerHTML + location.href + document.cookie"
        )

        page.click("#tab-admin")
        page.wait(lambda: "role does not allow" in page.text("#banner"), "the role is not enough")
        assert page.text("#quarantine") == page.text("#audit") == ""
        enter_token(page, tokens["admin"])
        page.wait(lambda: page.all("#quarantine .card"), "the quarantined one")
        assert "<i>liar</i>" in page.text("#quarantine .card")
        assert "standard deviations" in page.text("#quarantine .reasons")
        assert page.all("#audit tbody tr")
        assert page.js(NAMELESS) == []
        assert page.js(CONTRAST)[1] == []
        page.click("#quarantine .danger")
        page.wait(lambda: "Nothing is in quarantine" in page.text("#quarantine"), "rejected")
        page.wait(lambda: page.focused("id") == "quarantine-title", "the focus on the heading")
        assert "reject" in page.text("#audit tbody tr")
        (held,) = store.contributions(status="rejected")
        assert "0.4" in held["body"]

        page.click("#tab-sources")
        page.wait_rows(1)
        page.click("#rows button")
        page.wait(lambda: page.all("svg.allan"), "the plot")
        store.revoke_token(tokens["admin"].split("_")[1])
        page.click("#refresh")
        page.wait(lambda: "refused" in page.text("#banner"), "the revoked token is refused")
        assert page.names() == []
        assert not page.one("#detail").is_displayed()
        page.click("#token-button")
        page.click("#token-forget")
        page.wait(lambda: "only with a token" in page.text("#banner"), "reading needs a token")
        assert page.js("return sessionStorage.length") == 0


@pytest.mark.slow
def test_answers_that_go_wrong(driver: webdriver.Chrome, service: Running) -> None:
    """A proxy before the service: too many requests, a fault, no JSON, nothing at all."""
    import httpx

    mode = {"now": "pass"}
    static = {}

    async def app(scope: Any, receive: Any, send: Any) -> None:
        if scope["type"] == "lifespan":
            while True:
                message = await receive()
                await send({"type": f"{message['type']}.complete"})
                if message["type"] == "lifespan.shutdown":
                    return
        path = scope["path"]
        answers = {
            "429": (429, b"{}"),
            "500": (500, b"oops"),
            "html": (200, b"<p>login</p>"),
            "422": (422, b'{"detail": "no", "errors": [{"field": "limit", "message": "too large"}]}'),
        }
        status, data, extra = 200, b"", [(b"content-type", b"application/json")]
        if path.startswith("/v1/") and mode["now"] in answers:
            status, data = answers[mode["now"]]
            extra.append((b"retry-after", b"7"))
        else:
            if path not in static:
                async with httpx.AsyncClient() as client:
                    static[path] = await client.get(service.url + path)
            answer = static[path]
            status, data = answer.status_code, answer.content
            extra = [(k.lower().encode(), v.encode()) for k, v in answer.headers.items() if k.lower() == "content-type"]
        await send({"type": "http.response.start", "status": status, "headers": extra})
        await send({"type": "http.response.body", "body": data})

    page = Page(driver)
    with serving(app) as url:
        page.open(f"{url}/")
        page.wait_rows(50)
        for name, sentence in (
            ("429", "Too many requests: the service asks to wait. Trying again in 7 s."),
            ("500", "The service has a fault of its own (500)."),
            ("html", "not JSON"),
            ("422", "did not accept the request: no; limit: too large"),
        ):
            mode["now"] = name
            page.click("#refresh")
            page.wait(lambda: sentence in page.text("#banner"), sentence)  # noqa: B023
            assert page.one("#banner").get_attribute("role") == "alert"
        mode["now"] = "pass"
        page.click("#refresh")
        page.wait(lambda: not page.one("#banner").is_displayed(), "all is well again")
    page.click("#refresh")
    page.wait(lambda: "does not answer" in page.text("#banner"), "the server is gone")
    assert "Try again" in page.text("#banner")
    assert len(page.names()) == 50
