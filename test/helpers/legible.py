"""Whether a page in a browser can be read: contrasts as WCAG 2 computes them, and what is wider than its place."""

from __future__ import annotations

from playwright.sync_api import Page

#: Least ratio of brightness for text, and for large text (24 px, or 18.7 px and bold).
LEAST, LEAST_LARGE = 4.5, 3.0
WIDTHS = (1366, 700, 390)

_FAINT = """([least, leastLarge]) => {
  const context = Object.assign(document.createElement("canvas"), {width: 1, height: 1}).getContext("2d", {willReadFrequently: true});
  const known = new Map();
  const bytes = (colour) => {
    if (!known.has(colour)) {
      context.clearRect(0, 0, 1, 1);
      context.fillStyle = colour;
      context.fillRect(0, 0, 1, 1);
      const [r, g, b, a] = context.getImageData(0, 0, 1, 1).data;
      known.set(colour, [r, g, b, a / 255]);
    }
    return known.get(colour);
  };
  const over = (top, below) => [0, 1, 2].map((i) => top[3] * top[i] + (1 - top[3]) * below[i]);
  const light = (rgb) => {
    const [r, g, b] = rgb.map((v) => v / 255).map((v) => v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4);
    return 0.2126 * r + 0.7152 * g + 0.0722 * b;
  };
  const dark = getComputedStyle(document.documentElement).colorScheme.includes("dark");
  const behind = (element) => {
    const layers = [];
    for (let e = element; e; e = e.parentElement) {
      const layer = bytes(getComputedStyle(e).backgroundColor);
      if (layer[3] > 0) layers.push(layer);
      if (layer[3] === 1) break;
    }
    return layers.reduceRight((below, top) => over(top, below), dark ? [18, 18, 18] : [255, 255, 255]);
  };
  // What just comes or goes is read before or after; what turns for ever is read as it is.
  const fades = (animation) => animation.playState === "running" && Number.isFinite(animation.effect.getComputedTiming().endTime);
  const found = [];
  const judge = (element, text) => {
    if (!element.checkVisibility({opacityProperty: true, visibilityProperty: true})) return;
    if (element.closest("[disabled], [data-disabled], [aria-hidden=true], .headerlink, mjx-container")) return;
    const box = element.getBoundingClientRect(), style = getComputedStyle(element);
    if (box.width < 2 || box.height < 2) return;
    let colour = bytes(element instanceof SVGElement ? style.fill : style.color);
    let opacity = 1;
    for (let e = element; e; e = e.parentElement) {
      if (e.getAnimations().some(fades)) return;
      opacity *= Number(getComputedStyle(e).opacity);
    }
    const back = behind(element), ink = light(over([colour[0], colour[1], colour[2], colour[3] * opacity], back)), paper = light(back);
    const ratio = (Math.max(ink, paper) + 0.05) / (Math.min(ink, paper) + 0.05), size = parseFloat(style.fontSize);
    const large = size >= 24 || (size >= 18.6 && Number(style.fontWeight) >= 700);
    if (ratio < (large ? leastLarge : least) - 0.005) found.push(
      `${ratio.toFixed(2)}: ${text.trim().slice(0, 40)} <${element.tagName} ${element.className}>`);
  };
  const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  while (walker.nextNode()) {
    const {parentElement: element, data} = walker.currentNode;
    if (data.trim() && element && !["SCRIPT", "STYLE", "NOSCRIPT", "TITLE"].includes(element.tagName)) judge(element, data);
  }
  for (const input of document.querySelectorAll("input:not([type=hidden]):not([type=checkbox])"))
    if (input.value) judge(input, input.value);
  return [...new Set(found)];
}"""

_WIDE = """() => {
  const found = [], article = document.querySelector("article");
  const held = (element) => {  // by something that scrolls by itself
    for (let e = element.parentElement; e && e !== article; e = e.parentElement)
      if (getComputedStyle(e).overflowX !== "visible") return true;
    return false;
  };
  const wide = document.documentElement.scrollWidth;
  if (!article && wide > innerWidth) found.push(`the page is ${wide} px wide`);
  for (const element of article?.querySelectorAll("*") ?? [])
    if (element.checkVisibility() && element.getBoundingClientRect().right > innerWidth + 1 && !held(element))
      found.push(`${element.tagName} ${element.textContent.trim().slice(0, 40)} is wider than the window`);
  for (const input of document.querySelectorAll("input"))
    if (input.offsetWidth && input.scrollWidth > input.clientWidth + 1) found.push(`${input.value} is cut off`);
  for (const element of document.querySelectorAll("button, label, td, th, .lp-status *")) {
    const hides = getComputedStyle(element).overflowX !== "visible";
    if (element.checkVisibility() && hides && element.scrollWidth > element.clientWidth + 1)
      found.push(`${element.textContent.trim()} is cut off`);
  }
  return found;
}"""


def faint(page: Page) -> list[str]:
    """Return the texts of too little contrast against what is behind them, with the ratio."""
    return list(page.evaluate(_FAINT, [LEAST, LEAST_LARGE]))


def too_wide(page: Page) -> list[str]:
    """Return what does not fit: a page that scrolls sideways, values and labels that are cut off."""
    return list(page.evaluate(_WIDE))
