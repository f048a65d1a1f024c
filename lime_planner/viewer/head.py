"""What we add to the head of viser's page: title, icon, colour scheme, and style sheets of our own.

Viser serves one file of HTML. Its own options know neither the title nor the scheme that the browser asks for.
"""

from __future__ import annotations

import gzip
import re
from functools import lru_cache

#: A slice of lime, for the browser's tab.
_ICON = (
    "data:image/svg+xml,%3Csvg xmlns='http://www.w3.org/2000/svg' viewBox='0 0 32 32'%3E"
    "%3Ccircle cx='16' cy='16' r='15' fill='%234c8c2b'/%3E"
    "%3Ccircle cx='16' cy='16' r='12' fill='%23e6f2b3'/%3E%3Cg stroke='%238fbf4d' stroke-width='2.4'%3E"
    "%3Cpath d='M16 6v20M6 16h20M9 9l14 14M23 9L9 23'/%3E%3C/g%3E%3C/svg%3E"
)

# The client draws without pause. Where a frame takes long (no graphics card, a busy machine), it would leave no time for clicks and
# messages: then the next one waits as long as the last one took. It takes in messages with its frames, of which a window that is behind
# another gets none: a timer stands in for them. The client takes its first colour scheme from the object that is put
# into the window. The tab's title follows the status line (`data-state`), and viser's own warning about drawing by software, which hides
# a third of a phone's screen, closes by itself.
_SCRIPT = """
(() => {
  const ask = requestAnimationFrame.bind(window), cancel = cancelAnimationFrame.bind(window), waiting = new Map();
  let number = 0, pause_ms = 0;
  window.requestAnimationFrame = (call) => {
    const id = ++number;
    const begin = () => {
      const asked = performance.now(), held = {};
      const run = (drawn) => (time) => {
        window.cancelAnimationFrame(id);
        call(time ?? performance.now());
        const took_ms = performance.now() - asked;
        pause_ms = drawn && took_ms > 80 ? Math.min(took_ms, 500) : 0;
      };
      held.frame = ask(run(true));
      held.timer = setTimeout(run(false), 1000);
      waiting.set(id, held);
    };
    if (pause_ms) waiting.set(id, {timer: setTimeout(begin, pause_ms)});
    else begin();
    return id;
  };
  window.cancelAnimationFrame = (id) => {
    const held = waiting.get(id);
    waiting.delete(id);
    if (held?.timer) clearTimeout(held.timer);
    if (held?.frame) cancel(held.frame);
  };
  const dark = matchMedia("(prefers-color-scheme: dark)");
  window.__VISER_EMBED_CONFIG__ = {darkMode: dark.matches};
  let seen = 0;
  setInterval(() => {
    const state = document.querySelector("[data-state]");
    const title = state ? state.dataset.state + " \\u00b7 Lime planner" : "Lime planner";
    if (document.title !== title) document.title = title;
    for (const box of document.querySelectorAll(".mantine-Notification-root"))
      if (box.textContent.startsWith("Software WebGL") && ++seen > 8) box.querySelector("button")?.click();
  }, 1000);
})();
"""

# The client sends what is typed 50 ms apart at most, and keeps only the newest message of the whole panel meanwhile: the last number of one
# field would never arrive when the first of the next is typed at once. While something is typed that pause is left out.
_TYPING = """
(() => {
  const PAUSE_MS = 50, later = setTimeout.bind(window);
  let typing = false;
  for (const name of ["input", "change", "keydown", "focusout"])
    addEventListener(name, () => { typing = true; later(() => { typing = false; }, 0); }, {passive: true, capture: true});
  window.setTimeout = (call, delay_ms, ...given) => {
    if (!typing || delay_ms !== PAUSE_MS || typeof call !== "function") return later(call, delay_ms, ...given);
    queueMicrotask(() => call(...given));
    return 0;
  };
})();
"""

# Viser tells clicks in the scene and no moves of the pointer. Where it rests we ask the server what is drawn there, and say it beside it.
# The camera is the client's own, which it lays into the window for its tests; without it, there still is the click.
_POINTER = """
(() => {
  const tip = document.createElement("div"), rest_ms = 180;
  tip.className = "lp-under";
  tip.setAttribute("role", "tooltip");
  let timer = 0, number = 0, at = [0, 0];
  const hide = () => { clearTimeout(timer); number += 1; tip.remove(); };
  const ask = async (canvas, x, y) => {
    const {camera, nodeRefFromName} = window.__viserMutable ?? {}, root = nodeRefFromName?.[""];
    if (!camera || !root) return;
    const box = canvas.getBoundingClientRect(), mine = ++number;
    const eye = camera.getWorldPosition(camera.position.clone());
    const far = eye.clone().set(2 * (x - box.left) / box.width - 1, 1 - 2 * (y - box.top) / box.height, 0.5).unproject(camera);
    root.worldToLocal(eye);
    root.worldToLocal(far).sub(eye).normalize();
    const ray = [eye.x, eye.y, eye.z, far.x, far.y, far.z].map((value) => value.toFixed(6)).join(",");
    const found = await fetch("under?ray=" + ray).then((answer) => answer.json()).catch(() => null);
    if (mine !== number || !found) return;
    const name = document.createElement("b");
    name.textContent = found.title;
    tip.replaceChildren(name, " ", found.sentence);
    document.body.append(tip);
    tip.style.left = Math.max(4, Math.min(x + 14, innerWidth - tip.offsetWidth - 4)) + "px";
    tip.style.top = (y + 18 + tip.offsetHeight > innerHeight ? y - tip.offsetHeight - 10 : y + 18) + "px";
  };
  addEventListener("pointermove", (event) => {
    const {target, clientX: x, clientY: y} = event;
    if (tip.isConnected && target.tagName === "CANVAS" && Math.hypot(x - at[0], y - at[1]) < 3) return;
    hide();
    if (event.pointerType === "touch" || event.buttons || target.tagName !== "CANVAS") return;
    at = [x, y];
    timer = setTimeout(ask, rest_ms, target, x, y);
  }, {passive: true, capture: true});
  for (const name of ["pointerdown", "wheel", "keydown", "blur"]) addEventListener(name, hide, {passive: true, capture: true});
  document.addEventListener("pointerleave", hide);
})();
"""

# The canvas is narrow beside the panel, and on a phone the panel lies over it: what the camera looks at goes to the middle of the part that
# is free, and as small as it takes to fit in there, whatever the camera is and however the window changes. The projection alone is moved,
# so the rays of clicks and of the pointer stay right.
_FREE_PART = """
(() => {
  const WIDEST = 1.35, PANEL = "[style*='position: fixed'][style*='max-height: 60%']";
  let camera = null, key = "";
  const place = () => {
    const canvas = document.querySelector("canvas"), now = window.__viserMutable?.camera;
    if (!canvas || !now?.setViewOffset) return;
    const box = canvas.getBoundingClientRect(), sheet = document.querySelector(PANEL)?.getBoundingClientRect();
    let low = box.bottom;
    if (sheet && sheet.width > 0.7 * box.width && sheet.top > box.top + 0.25 * box.height) low = Math.min(low, sheet.top);
    const {width, height} = box, free = low - box.top, new_key = [width, height, free].map(Math.round).join();
    if (!(width > 0 && free > 0) || (now === camera && new_key === key)) return;
    [camera, key] = [now, new_key];
    const times = height / Math.min(free, WIDEST * width), [across, up] = [width / times, height / times];
    if (times < 1.01) camera.clearViewOffset();
    else camera.setViewOffset(across, up, 0.5 * (across - width), 0.5 * (up - free), width, height);
  };
  setInterval(place, 200);
  addEventListener("resize", () => setTimeout(place, 60));
})();
"""

# What viser leaves to the mouse alone: its folders' headings are no buttons, sliders and the numbers beside them have no names.
# Escape stops: who sees the arm go wrong has no time to find the button.
_KEYBOARD = """
(() => {
  const HEADING = ".mantine-Paper-root > .mantine-Paper-root", FIELD = "input:not([type=hidden]), [role=slider]";
  const put = (element, name, value) => { if (element.getAttribute(name) !== value) element.setAttribute(name, value); };
  const dress = () => {
    for (const heading of document.querySelectorAll(HEADING)) {
      if (heading.style.cursor !== "pointer") continue;
      put(heading, "role", "button");
      put(heading, "tabindex", "0");
      put(heading, "aria-expanded", String(heading.querySelector("svg.tabler-icon-chevron-up") !== null));
    }
    for (const label of document.querySelectorAll("label[for]")) {
      const fields = [...label.closest(".mantine-Flex-root")?.querySelectorAll(FIELD) ?? []];
      const numbers = fields.filter((field) => field.tagName === "INPUT");
      for (const field of fields) {
        const place = numbers.length > 1 && field.tagName === "INPUT" ? `, ${numbers.indexOf(field) + 1} of ${numbers.length}` : "";
        put(field, "aria-label", label.textContent + place);
      }
    }
    for (const button of document.querySelectorAll("button:not([aria-label]) > .mantine-ActionIcon-icon"))
      put(button.parentElement, "aria-label", "The page's own settings");
  };
  let waiting = 0;
  new MutationObserver(() => { waiting ||= setTimeout(() => { waiting = 0; dress(); }, 100); })
    .observe(document, {childList: true, subtree: true});
  addEventListener("keydown", (event) => {
    if ((event.key === "Enter" || event.key === " ") && event.target.matches?.(HEADING)) {
      event.preventDefault();
      event.target.click();
    }
    if (event.key !== "Escape" || event.repeat) return;
    const state = document.querySelector("[data-state]")?.dataset.state ?? "";
    const stop = [...document.querySelectorAll("button")].find((button) => button.textContent.trim() === "Stop");
    if (/^(Planning|The arm)/.test(state)) stop?.click();
  }, {capture: true});
})();
"""

_STYLE = """
:root { --lp-soft: #5c6066; --lp-line: #d8dade; --lp-bad: #b3261e; --lp-bad-back: #fdecea; --lp-good: #1b7a35; --lp-back: #f3f4f6;
  --lp-warn: #8a5300; --lp-ink: #1c1e21; --lp-free: #0072b2; --lp-leafy: #c24f00; --lp-stem: #73451f; --lp-other: #8a4f9e; }
:root[data-mantine-color-scheme="dark"] { --lp-soft: #a9adb4; --lp-line: #45484d; --lp-bad: #ff8a80; --lp-bad-back: #45211f;
  --lp-ink: #e6e7ea; --lp-good: #6fcf87; --lp-warn: #ffc46b; --lp-back: #2f3136; --lp-free: #5db5ea; --lp-leafy: #ff9a4d;
  --lp-stem: #c99a6f; --lp-other: #d19be3; }
/* Mantine's own greys and blues have less than 4.5:1 on white. */
:root:root[data-mantine-color-scheme] { --mantine-color-dimmed: var(--lp-soft); }
:root:root[data-mantine-color-scheme="light"] { --mantine-color-gray-filled: #5c6066; --mantine-color-gray-filled-hover: #4a4e53; }
.mantine-Button-root[data-variant="outline"] {
  --button-color: var(--lp-free) !important; --button-bd: 1px solid var(--lp-free) !important; }
.mantine-Notification-description, .mantine-Slider-markLabel { color: var(--lp-soft) !important; }
.lp-status { margin: 0 10px 6px; border-left: 4px solid var(--lp-soft); padding: 4px 8px; border-radius: 3px; background: var(--lp-back);
  line-height: 1.35; }
.lp-status b { font-size: 1.02em; }
.lp-status.refused { border-color: var(--lp-bad); background: var(--lp-bad-back); }
.lp-status.refused b { color: var(--lp-bad); }
.lp-status.found { border-color: var(--lp-good); }
.lp-status .what { font-size: 0.88em; overflow-wrap: anywhere; }
.lp-status .warning { font-size: 0.88em; overflow-wrap: anywhere; margin: 4px 0; padding-left: 6px; border-left: 3px solid var(--lp-warn); }
.lp-status .warning b { color: var(--lp-warn); }
.lp-status .note { font-size: 0.8em; color: var(--lp-soft); }
.lp-table { width: calc(100% - 20px); margin: 2px 10px 4px; border-collapse: collapse; font-size: 0.84em;
  font-variant-numeric: tabular-nums; }
.lp-table td, .lp-table th { padding: 1px 6px 1px 0; vertical-align: top; text-align: left; font-weight: normal; }
.lp-table td:first-child, .lp-table th { color: var(--lp-soft); white-space: nowrap; }
.lp-table td.n { text-align: right; white-space: nowrap; }
.lp-table td.better { color: var(--lp-good); font-weight: bold; }
.lp-legend { margin: 2px 10px 6px; display: grid; grid-template-columns: 1fr 1fr; gap: 2px 10px; font-size: 0.8em; }
.lp-legend i { display: inline-block; width: 12px; height: 12px; border-radius: 3px; margin-right: 6px; vertical-align: -1px; }
.mantine-Paper-root[role=button]:focus-visible { outline: 2px solid var(--lp-free); }
.lp-under { position: fixed; z-index: 50; max-width: 260px; padding: 4px 8px; border-radius: 4px; pointer-events: none; font-size: 0.82em;
  line-height: 1.35; color: var(--lp-ink); background: var(--lp-back);
  border: 1px solid var(--lp-line); box-shadow: 0 1px 6px rgb(0 0 0 / 25%); }
.lp-plot { display: block; width: 100%; height: auto; overflow: visible; }
.lp-plot text { font: 10px system-ui, sans-serif; fill: var(--lp-soft); }
.lp-plot .title { font-size: 11px; fill: currentColor; }
.lp-plot .grid { stroke: var(--lp-line); stroke-width: 1; }
.lp-plot .curve { fill: none; stroke-width: 1.8; }
/* On a phone viser's sheet is a box in a corner; ours is as wide as the screen and leaves more than half of it to the scene. */
@media (max-width: 36em) {
  [style*="position: fixed"][style*="max-height: 60%"] { width: 100% !important; max-height: 46% !important; }
  [style*="position: fixed"][style*="max-height: 60%"] [style*="width: 20em"] { width: 100vw !important; }
}
/* Three numbers in a row need their width for digits. */
.mantine-Flex-root > .mantine-NumberInput-root .mantine-NumberInput-section { display: none; }
.mantine-Flex-root > .mantine-NumberInput-root .mantine-NumberInput-input {
  padding-inline: 4px !important; font-size: 0.78em; letter-spacing: -0.02em; }
"""


def with_our_head(page: bytes, *, gzipped: bool) -> bytes:
    """Return viser's page with our title, icon, script and style.

    Args:
        page: the body of the response.
        gzipped: whether it is compressed; the result is as the argument was.
    """
    return _dressed(page, gzipped)


@lru_cache(maxsize=4)
def _dressed(page: bytes, gzipped: bool) -> bytes:
    html = gzip.decompress(page) if gzipped else page
    head = f'<link rel="icon" href="{_ICON}"/><script>{_SCRIPT}{_TYPING}{_FREE_PART}{_POINTER}{_KEYBOARD}</script><style>{_STYLE}</style>'
    html = re.sub(rb'<link\s+rel="icon"[^>]*>', b"", html, count=1)
    html = html.replace(b"<title>Viser</title>", f"<title>Lime planner</title>{head}".encode(), 1)
    return gzip.compress(html, 6) if gzipped else html
