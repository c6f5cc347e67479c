// Accessible tabs: a single stop for Tab; arrows, Home and End move between tabs.

export function start(onShow) {
  const tabs = [...document.querySelectorAll('[role="tab"]')];
  const show = (chosen, focus) => {
    for (const tab of tabs) {
      const selected = tab === chosen;
      tab.setAttribute('aria-selected', String(selected));
      tab.tabIndex = selected ? 0 : -1;
      document.getElementById(tab.getAttribute('aria-controls')).hidden = !selected;
    }
    if (focus) chosen.focus();
    chosen.scrollIntoView({ block: 'nearest', inline: 'nearest' });
    onShow();
  };
  for (const [index, tab] of tabs.entries()) {
    tab.onclick = () => show(tab, false);
    tab.onkeydown = (event) => {
      const last = tabs.length - 1;
      const next = { ArrowRight: index === last ? 0 : index + 1, ArrowLeft: index === 0 ? last : index - 1, Home: 0, End: last }[event.key];
      if (next === undefined) return;
      event.preventDefault();
      show(tabs[next], true);
    };
  }
  return { show: (id) => show(document.getElementById(id), false) };
}
