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

_STYLE = """
:root { --lp-soft: #5c6066; --lp-line: #d8dade; --lp-bad: #b3261e; --lp-bad-back: #fdecea; --lp-good: #1b7a35; --lp-back: #f3f4f6;
  --lp-free: #0072b2; --lp-leafy: #c24f00; --lp-stem: #73451f; --lp-other: #8a4f9e; }
:root[data-mantine-color-scheme="dark"] { --lp-soft: #a9adb4; --lp-line: #45484d; --lp-bad: #ff8a80; --lp-bad-back: #45211f;
  --lp-good: #6fcf87; --lp-back: #2f3136; --lp-free: #5db5ea; --lp-leafy: #ff9a4d; --lp-stem: #c99a6f; --lp-other: #d19be3; }
.lp-status { margin: 0 10px 6px; border-left: 4px solid var(--lp-soft); padding: 4px 8px; border-radius: 3px; background: var(--lp-back);
  line-height: 1.35; }
.lp-status b { font-size: 1.02em; }
.lp-status.refused { border-color: var(--lp-bad); background: var(--lp-bad-back); }
.lp-status.refused b { color: var(--lp-bad); }
.lp-status.found { border-color: var(--lp-good); }
.lp-status .what { font-size: 0.88em; overflow-wrap: anywhere; }
.lp-status .note { font-size: 0.8em; color: var(--lp-soft); }
.lp-table { width: calc(100% - 20px); margin: 2px 10px 4px; border-collapse: collapse; font-size: 0.84em;
  font-variant-numeric: tabular-nums; }
.lp-table td, .lp-table th { padding: 1px 6px 1px 0; vertical-align: top; text-align: left; font-weight: normal; }
.lp-table td:first-child, .lp-table th { color: var(--lp-soft); white-space: nowrap; }
.lp-table td.n { text-align: right; white-space: nowrap; }
.lp-table td.better { color: var(--lp-good); font-weight: bold; }
.lp-legend { display: grid; grid-template-columns: 1fr 1fr; gap: 2px 10px; font-size: 0.8em; }
.lp-legend i { display: inline-block; width: 12px; height: 12px; border-radius: 3px; margin-right: 6px; vertical-align: -1px; }
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
    head = f'<link rel="icon" href="{_ICON}"/><script>{_SCRIPT}</script><style>{_STYLE}</style>'
    html = re.sub(rb'<link\s+rel="icon"[^>]*>', b"", html, count=1)
    html = html.replace(b"<title>Viser</title>", f"<title>Lime planner</title>{head}".encode(), 1)
    return gzip.compress(html, 6) if gzipped else html
