"use strict";

// Draws every figure as the choices of its block say: which lines, and which horizontal axis.

const touched = matchMedia("(pointer: coarse)").matches;
const config = {displaylogo: false, responsive: true, showSendToCloud: false, plotlyServerURL: "",
                modeBarButtonsToRemove: ["select2d", "lasso2d", "autoScale2d"]};
const specifications = new Map();

function draw(figure, width) {
  if (!specifications.has(figure)) {
    const source = document.getElementById(figure.dataset.specification).textContent;
    specifications.set(figure, JSON.parse(source));
  }
  const {data, layout, axes} = specifications.get(figure);
  const block = figure.closest(".figures");
  const hidden = new Set();
  for (const box of block.querySelectorAll("input[type=checkbox]")) {
    if (!box.checked) hidden.add(box.value);
  }
  const axis = axes[block.querySelector("input[type=radio]:checked")?.value];
  const traces = data.map((trace, i) => ({
    ...trace,
    ...(axis && {x: axis.x[i]}),
    visible: !hidden.has(trace.legendgroup),
  }));
  return Plotly.react(figure, traces, {
    ...layout,
    ...(axis && {shapes: axis.shapes, xaxis: {...layout.xaxis, range: axis.range,
                 title: {...layout.xaxis.title, text: axis.title}}}),
    ...(touched && {dragmode: false}),  // a finger scrolls the page
    ...(width && {width, autosize: false}),
  }, config);
}

const figures = [...document.querySelectorAll(".figure")];

document.addEventListener("change", ({target}) => {
  const block = target.closest(".figures");
  if (block) block.querySelectorAll(".figure").forEach(figure => draw(figure));
});

document.addEventListener("click", ({target}) => {
  const every = target.dataset.every;
  if (!every) return;
  const block = target.closest(".figures");
  block.querySelectorAll("input[type=checkbox]").forEach(box => box.checked = every === "shown");
  block.querySelectorAll(".figure").forEach(figure => draw(figure));
});

addEventListener("beforeprint", () => figures.forEach(figure => draw(figure, 330)));
addEventListener("afterprint", () => figures.forEach(figure => draw(figure)));

(async () => {
  for (const figure of figures) {
    await draw(figure);
    await new Promise(resolve => setTimeout(resolve));  // the page stays usable meanwhile
  }
  document.documentElement.dataset.drawn = figures.length;
})();
