// Tabs by mouse and keyboard (WAI-ARIA pattern: arrows, Home, End); a tab's part starts on first use.

export function startTabs(starters) {
  const tabs = [...document.querySelectorAll('[role="tab"]')];
  const started = new Set();
  const show = (tab) => {
    for (const other of tabs) {
      const chosen = other === tab;
      other.setAttribute("aria-selected", String(chosen));
      other.tabIndex = chosen ? 0 : -1;
      document.getElementById(other.getAttribute("aria-controls")).hidden = !chosen;
    }
    const name = tab.id.replace("tab-", "");
    if (!started.has(name)) {
      started.add(name);
      starters[name]?.();
    }
    history.replaceState(null, "", `#${name}`);
    tab.scrollIntoView({ block: "nearest", inline: "nearest" });
  };
  for (const [index, tab] of tabs.entries()) {
    tab.addEventListener("click", () => show(tab));
    tab.addEventListener("keydown", (event) => {
      const next = { ArrowRight: index + 1, ArrowLeft: index - 1 + tabs.length, Home: 0, End: tabs.length - 1 }[event.key];
      if (next === undefined) return;
      event.preventDefault();
      const target = tabs[next % tabs.length];
      target.focus();
      show(target);
    });
  }
  show(tabs.find((tab) => tab.id === `tab-${location.hash.slice(1)}`) ?? tabs[0]);
}
