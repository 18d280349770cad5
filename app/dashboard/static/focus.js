// Where the focus goes when the thing that had it is drawn anew: to what it stood in, not to the top of the page.

/** Watch over what is drawn in an element that can have the focus. */
export function keepFocus(element) {
  let path = [];
  element.addEventListener("focusin", ({ target }) => {
    path = [];
    for (let one = target; one !== element; one = one.parentElement) path.push(one);
  });
  new MutationObserver(() => {
    if (!path.length || path[0].isConnected || document.activeElement !== document.body) return;
    const left = path.find((one) => one.isConnected && one.matches("section, [role=region]")) ?? element;
    path = [];
    if (!left.hasAttribute("tabindex")) left.setAttribute("tabindex", "-1");
    left.focus({ preventScroll: true });
  }).observe(element, { childList: true, subtree: true });
}
