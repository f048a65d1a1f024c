// Tells each cell of a table the name of its column, which a narrow screen shows in the cell (assets/extra.css).
document.addEventListener("DOMContentLoaded", () => {
  for (const table of document.querySelectorAll(".md-typeset table:not([class])")) {
    const names = [...table.querySelectorAll("thead th")].map((cell) => cell.textContent.trim());
    for (const row of table.querySelectorAll("tbody tr"))
      [...row.cells].forEach((cell, place) => names[place] && (cell.dataset.column = names[place]));
  }
});
