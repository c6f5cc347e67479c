// Status of the fleet: coordinator, connection, banner and key figures.

import { age, byId, make, percent, setText, span } from './dom.js';

let coordinator;

/** Announces a text to screen readers. */
export function announce(text) {
  setText(byId('announce'), text);
}

export function update(model) {
  setText(byId('fleet'), model.fleet);
  setText(byId('seen-by'), model.node);
  document.title = `Consort · ${model.fleet}`;
  const now = model.coordinator;
  if (now) {
    setText(byId('coordinator'), `${now.node}, term ${now.term}`);
    const name = `${now.node}/${now.term}`;
    if (coordinator && coordinator !== name) announce(`${now.node} is now the coordinator, in term ${now.term}`);
    coordinator = name;
  }
  health(model.health);
  figures(model.kpis);
}

/** Updates the connection and the ages as time passes. */
export function tick(connection) {
  const { model } = connection;
  const badge = byId('connection');
  const reachability = model?.reachability;
  // The ages change each second; they are not part of the announced text.
  let [kind, word, problem, contact] = ['good', 'live', '', ''];
  if (connection.state === 'connecting') [kind, word] = ['wait', 'connecting'];
  else if (connection.state === 'broken') {
    [kind, word] = ['bad', 'interrupted'];
    problem = 'The connection to this page’s node is interrupted and is being retried. The shown data is outdated.';
    contact = `Interrupted for ${age(Date.now() - connection.since)}.`;
  } else if (reachability && reachability.state !== 'connected') {
    contact = reachability.last_contact_ms ? `Last contact with a coordinator ${age(connection.now() - reachability.last_contact_ms)} ago.` : 'No contact with a coordinator yet.';
    if (!reachability.last_contact_ms && connection.now() - model.since_ms < 10000) [kind, word] = ['wait', 'waiting for the fleet'];
    else if (reachability.state === 'isolated') {
      [kind, word] = ['bad', 'cut off'];
      problem = `${model.node} is cut off: it has no links to other nodes. The shown data is outdated.`;
    } else {
      [kind, word] = ['bad', 'no coordinator'];
      problem = `There is no coordinator, as seen by ${model.node}. The shown data may be outdated.`;
    }
  }
  badge.className = `state ${kind}`;
  setText(badge, word);
  byId('banner').hidden = !problem;
  setText(byId('banner-what'), problem);
  setText(byId('banner-age'), problem ? contact : '');
  document.body.classList.toggle('stale', Boolean(problem));
}

/** Shows the health in a word; the coordination panel has the details. */
function health(findings) {
  const count = (level) => (findings ?? []).filter((finding) => finding.level === level).length;
  const some = (number, word) => (number ? `${number} ${word}${number > 1 ? 's' : ''}` : '');
  const [errors, warnings] = [count('error'), count('warning')];
  // A healthy fleet has at least a finding of level ok; without findings the health is unknown.
  const [kind, rest] = findings?.length ? ['good', 'ok'] : ['wait', 'unknown'];
  setText(byId('health'), [some(errors, 'error'), some(warnings, 'warning')].filter(Boolean).join(', ') || rest);
  byId('health').className = `state ${errors ? 'bad' : warnings ? 'warn' : kind}`;
}

function figures(kpis) {
  if (!kpis) return;
  const tiles = [
    ['Missions under way', String(kpis.under_way), `${kpis.missions} in all`],
    ['Success', kpis.success === undefined ? '–' : percent(kpis.success), `${kpis.completed} completed, ${kpis.failed} failed`],
    ['Time to complete', span(kpis.completion_ms), 'median, request to end'],
    ['Time to award', kpis.award_ms === undefined ? '–' : `${kpis.award_ms.toFixed(kpis.award_ms < 100 ? 1 : 0)} ms`, 'median, request to award'],
    ['Utilisation', kpis.utilisation === undefined ? '–' : percent(kpis.utilisation), `${kpis.busy} of ${kpis.in_service} robots at work`],
    ['Takeovers', String(kpis.takeovers), kpis.takeover_ms === undefined ? 'of the coordinator' : `the last within ${span(kpis.takeover_ms)}`],
  ];
  const list = byId('kpis');
  while (list.children.length < tiles.length) {
    list.append(make('div', {}, make('dt'), make('dd', { className: 'value' }), make('dd', { className: 'more' })));
  }
  tiles.forEach((texts, index) => texts.forEach((text, part) => setText(list.children[index].children[part], text)));
}

