// Light or dark theme: the system's preference, until the user selects a theme.

import { byId, setText } from './dom.js';

const KEY = 'consort-theme';
const system = matchMedia('(prefers-color-scheme: dark)');

export function start(onChange) {
  const stored = () => {
    try { return localStorage.getItem(KEY); } catch { return null; }
  };
  const apply = () => {
    const theme = stored() ?? (system.matches ? 'dark' : 'light');
    document.documentElement.dataset.theme = theme;
    const other = theme === 'dark' ? 'Light' : 'Dark';
    setText(byId('theme'), other);
    byId('theme').setAttribute('aria-label', `Use ${other.toLowerCase()} colours`);
    onChange();
  };
  byId('theme').onclick = () => {
    const next = document.documentElement.dataset.theme === 'dark' ? 'light' : 'dark';
    try { localStorage.setItem(KEY, next); } catch { /* the choice is not stored */ }
    document.documentElement.dataset.theme = next;
    apply();
  };
  system.onchange = apply;
  apply();
}
