// Tabs as a keyboard expects them: one stop for Tab, arrows, Home and End between them.

export function start(onShow) {
  const tabs = [...document.querySelectorAll('[role="tab"]')];
  const show = (chosen, focus) => {
    for (const tab of tabs) {
      const is = tab === chosen;
      tab.setAttribute('aria-selected', String(is));
      tab.tabIndex = is ? 0 : -1;
      document.getElementById(tab.getAttribute('aria-controls')).hidden = !is;
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
