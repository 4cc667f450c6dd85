// A button below every table saves it as CSV: whole case ids, unrounded numbers, one number a column.
import { saveBlob } from "./save.js";

const quoted = (text) => (/[",\n]/.test(text) ? `"${text.replaceAll('"', '""')}"` : text);
// An ordinary minus, and nothing where a value is unknown.
const plain = (text) => (text === "–" ? "" : text.replace(/^−(?=[\d.])/, "-"));
/** What a cell of the body, or of the head, contributes to a row of the CSV. */
const valuesOf = (cell) => (cell.dataset.values ? JSON.parse(cell.dataset.values) : [plain(cell.textContent.trim())]);
const namesOf = (th) => (th.dataset.names ? JSON.parse(th.dataset.names) : [th.textContent.trim()]);

/** The table as CSV; a head of two rows becomes one line. */
export function csvOf(table) {
  const rows = [...table.querySelectorAll("tbody tr")].map((tr) => [...tr.cells].flatMap(valuesOf));
  return [heads(table).flatMap(namesOf), ...rows].map((row) => row.map(quoted).join(",")).join("\n") + "\n";
}

/** The head's cells from left to right: those that span both rows, and those below a group. */
function heads(table) {
  const [upper, lower] = [...table.tHead.rows].map((row) => [...row.cells]);
  if (!lower) return upper;
  return upper.flatMap((th) => (th.rowSpan > 1 ? [th] : lower.splice(0, th.colSpan)));
}

export function offerTables(study) {
  for (const button of document.querySelectorAll("button[data-save]")) {
    button.addEventListener("click", () => {
      const name = `${study}_${button.dataset.save.replace("table-", "")}.csv`;
      saveBlob(new Blob([csvOf(document.getElementById(button.dataset.save))], { type: "text/csv" }), name);
    });
  }
}
