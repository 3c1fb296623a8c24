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

// One tab is one visitor, also after a reload: its name is the last part of the WebSocket's
// address, which the viewer takes from the parameter `websocket`.
const KEY = "cablesense-visitor";
if (!sessionStorage.getItem(KEY)) {
  const numbers = crypto.getRandomValues(new Uint32Array(4));
  sessionStorage.setItem(KEY, Array.from(numbers, (n) => n.toString(36)).join("-"));
}
const page = location.origin.replace(/^http/, "ws") + location.pathname.replace(/\/$/, "");
history.replaceState(null, "", `?websocket=${page}/${sessionStorage.getItem(KEY)}`);
