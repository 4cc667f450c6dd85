// A button on every table's caption: the table as CSV, with whole case ids and unrounded numbers.

const quoted = (text) => (/[",\n]/.test(text) ? `"${text.replaceAll('"', '""')}"` : text);

/** The table's text: two heads become one line, a cell that stands for more gives all of it. */
export function csvOf(table) {
  const heads = [...table.querySelectorAll("thead tr:last-child th")].map((th) => th.dataset.name ?? th.textContent.trim());
  const upper = [...table.querySelectorAll("thead tr:first-child th[rowspan]")].map((th) => th.dataset.name ?? th.textContent.trim());
  const columns = table.querySelectorAll("thead tr").length > 1 ? order(table, upper, heads) : heads;
  const rows = [...table.querySelectorAll("tbody tr")].map((tr) => [...tr.cells].map((cell) => cell.dataset.whole ?? cell.textContent.trim()));
  return [columns, ...rows].map((row) => row.map(quoted).join(",")).join("\n") + "\n";
}

/** Names of columns from left to right: those that span both rows, and those under a group. */
function order(table, upper, lower) {
  const columns = [];
  for (const th of table.querySelectorAll("thead tr:first-child th")) {
    if (th.rowSpan > 1) columns.push(upper.shift());
    else for (let i = 0; i < th.colSpan; i++) columns.push(lower.shift());
  }
  return columns;
}

export function offerTables(study) {
  for (const button of document.querySelectorAll("button[data-save]")) {
    button.addEventListener("click", () => {
      const link = document.createElement("a");
      link.href = URL.createObjectURL(new Blob([csvOf(document.getElementById(button.dataset.save))], { type: "text/csv" }));
      link.download = `${study}_${button.dataset.save.replace("table-", "")}.csv`;
      link.click();
      setTimeout(() => URL.revokeObjectURL(link.href), 10000);
    });
  }
}
