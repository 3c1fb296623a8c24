"use strict";
// Runs in the browser before the viewer starts; guard.py puts it into the page's head.

// Arrow keys belong to the slider that has the focus. The viewer turns its camera by those that
// reach the document; the slider itself has heard them before they come to the body.
document.addEventListener("DOMContentLoaded", () => {
  document.body.addEventListener("keydown", (event) => {
    if (event.key.startsWith("Arrow") && event.target.closest("[role=slider]")) {
      event.stopPropagation();
    }
  });
});
