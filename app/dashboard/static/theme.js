// A plain script, so that it runs before the first paint: the colours must not change under the reader's eyes.
"use strict";
{
  const chosen = localStorage.getItem("isodyn.theme");
  if (chosen === "light" || chosen === "dark") document.documentElement.dataset.theme = chosen;
}
