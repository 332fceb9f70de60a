"use strict";

// Hides the lines of rows that are not ticked, in the figures of their table.
document.addEventListener("change", ({target}) => {
  target.closest("section").querySelectorAll("[data-key]").forEach(line => {
    if (line.dataset.key === target.value) line.style.display = target.checked ? "" : "none";
  });
});
