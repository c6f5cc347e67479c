// What is true of the whole: the coordinator, the connection, the banner, the key figures.

import { age, byId, make, percent, say, span } from './dom.js';

let coordinator;

/** Says something to whoever listens instead of looking. */
export function announce(text) {
  say(byId('announce'), text);
}

export function update(picture) {
  say(byId('fleet'), picture.fleet);
  say(byId('seen-by'), picture.node);
  document.title = `Consort · ${picture.fleet}`;
  const now = picture.coordinator;
  if (now) {
    say(byId('coordinator'), `${now.node}, term ${now.term}`);
    const name = `${now.node}/${now.term}`;
    if (coordinator && coordinator !== name) announce(`${now.node} coordinates now, in term ${now.term}`);
    coordinator = name;
  }
  health(picture.health);
  figures(picture.kpis);
}

/** The line and the fleet grow old without anybody saying so. */
export function tick(line) {
  const { picture } = line;
  const connection = byId('connection');
  const reach = picture?.reach;
  // The ages change each second; they are beside what is said aloud.
  let [kind, word, trouble, old] = ['good', 'live', '', ''];
  if (line.state === 'connecting') [kind, word] = ['wait', 'connecting'];
  else if (line.state === 'broken') {
    [kind, word] = ['bad', 'interrupted'];
    trouble = 'The connection to this page’s node is interrupted; it is tried again. What is shown is of before.';
    old = `Interrupted for ${age(Date.now() - line.since)}.`;
  } else if (reach && reach.state !== 'whole') {
    old = reach.heard_ms ? `A coordinator was last heard ${age(line.now() - reach.heard_ms)} ago.` : 'No coordinator was heard yet.';
    if (!reach.heard_ms && line.now() - picture.since_ms < 10000) [kind, word] = ['wait', 'waiting for the fleet'];
    else if (reach.state === 'alone') {
      [kind, word] = ['bad', 'cut off'];
      trouble = `${picture.node} is cut off: it is linked to no other node. What is shown is of before.`;
    } else {
      [kind, word] = ['bad', 'no coordinator'];
      trouble = `Nobody coordinates, as far as ${picture.node} hears. What is shown may be of before.`;
    }
  }
  connection.className = `state ${kind}`;
  say(connection, word);
  byId('banner').hidden = !trouble;
  say(byId('banner-what'), trouble);
  say(byId('banner-age'), trouble ? old : '');
  document.body.classList.toggle('stale', Boolean(trouble));
}

/** What is the matter, in a word; the panel of coordination has it in full. */
function health(findings) {
  const count = (level) => (findings ?? []).filter((one) => one.level === level).length;
  const some = (number, word) => (number ? `${number} ${word}${number > 1 ? 's' : ''}` : '');
  const [errors, warnings] = [count('error'), count('warning')];
  // One finding at least says that all is well; before the first is heard of a fleet, nothing is known.
  const [kind, rest] = findings?.length ? ['good', 'well'] : ['wait', 'not known'];
  say(byId('health'), [some(errors, 'error'), some(warnings, 'warning')].filter(Boolean).join(', ') || rest);
  byId('health').className = `state ${errors ? 'bad' : warnings ? 'warn' : kind}`;
}

function figures(kpis) {
  if (!kpis) return;
  const tiles = [
    ['Missions under way', String(kpis.under_way), `${kpis.missions} in all`],
    ['Success', kpis.success === undefined ? '–' : percent(kpis.success), `${kpis.completed} completed, ${kpis.failed} failed`],
    ['Time to conclude', span(kpis.conclude_ms), 'median, request to end'],
    ['Time to award', kpis.award_ms === undefined ? '–' : `${kpis.award_ms.toFixed(kpis.award_ms < 100 ? 1 : 0)} ms`, 'median, request to award'],
    ['Utilisation', kpis.utilisation === undefined ? '–' : percent(kpis.utilisation), `${kpis.busy} of ${kpis.in_service} robots at work`],
    ['Takeovers', String(kpis.takeovers), kpis.takeover_ms === undefined ? 'of the coordinator' : `the last within ${span(kpis.takeover_ms)}`],
  ];
  const list = byId('kpis');
  while (list.children.length < tiles.length) {
    list.append(make('div', {}, make('dt'), make('dd', { className: 'value' }), make('dd', { className: 'more' })));
  }
  tiles.forEach((texts, index) => texts.forEach((text, part) => say(list.children[index].children[part], text)));
}

