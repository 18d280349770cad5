// Links to pages that a version of the dashboard may lack.

import { pages } from "./pages/index.js";

/** "#/sessions/ses_1" if there is a page for that, else null. */
export function hrefOf(path) {
  const parts = path.split("/");
  const fits = (page) => {
    const wanted = page.path.split("/");
    return wanted.length === parts.length && wanted.every((part, i) => part.startsWith(":") || part === parts[i]);
  };
  return pages.some(fits) ? `#${path}` : null;
}
