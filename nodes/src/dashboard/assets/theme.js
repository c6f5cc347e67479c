// Light or dark: as the system has it, until somebody says otherwise.

import { byId, say } from './dom.js';

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
    say(byId('theme'), other);
    byId('theme').setAttribute('aria-label', `Use ${other.toLowerCase()} colours`);
    onChange();
  };
  byId('theme').onclick = () => {
    const next = document.documentElement.dataset.theme === 'dark' ? 'light' : 'dark';
    try { localStorage.setItem(KEY, next); } catch { /* not kept, then */ }
    document.documentElement.dataset.theme = next;
    apply();
  };
  system.onchange = apply;
  apply();
}
