// Auctions: every answer for each role with its parts, and the reason of the assignment.

import { byId, cells, clock, make, meter, numberCell, percent, redraw, state } from './dom.js';

let chosen;

export function start(onChange) {
  byId('auction-choice').onchange = (event) => {
    chosen = event.target.value;
    onChange();
  };
}

export function update(model) {
  const all = Object.entries(model.auctions ?? {}).sort(([, a], [, b]) => b.at_ms - a.at_ms);
  const choice = byId('auction-choice');
  byId('auctions-none').hidden = all.length > 0;
  choice.parentElement.hidden = all.length === 0;
  const names = all.map(([name]) => name).join();
  if (choice.dataset.names !== names) {
    choice.dataset.names = names;
    const title = (auction) => `${auction.mission}, round ${auction.round}, ${clock(auction.at_ms)}${auction.failure ? ' (no award)' : ''}`;
    choice.replaceChildren(...all.map(([name, auction]) => make('option', { value: name }, title(auction))));
  }
  const [name, auction] = all.find(([id]) => id === chosen) ?? all[0] ?? [];
  if (!name) return;
  choice.value = name;
  const place = byId('auction');
  const shown = JSON.stringify([name, auction]);
  if (place.shown === shown) return;
  place.shown = shown;
  const roles = [...new Set((auction.offers ?? []).map((offer) => offer.role))];
  redraw(
    place,
    auction.failure ? make('p', { className: 'cause bad' }, auction.failure) : null,
    roles.map((role) => [make('h3', {}, role, auction.chosen?.[role] ? `: ${auction.chosen[role]}` : ''), reason(auction, role), offers(auction, role)]).flat(),
    auction.omitted ? make('p', { className: 'muted' }, `${auction.omitted} more answers were left out of the record.`) : null,
  );
}

/** Returns the reason of the assignment, in a sentence. */
function reason(auction, role) {
  const viable = auction.offers.filter((offer) => offer.role === role && offer.verdict === 'bid');
  const winner = viable.find((offer) => offer.chosen);
  if (!winner) return null;
  const others = viable.filter((offer) => offer !== winner).sort((a, b) => a.time_s - b.time_s);
  const text = others.length === 0
    ? `${winner.robot} made the only viable bid.`
    : winner.time_s <= others[0].time_s
      ? `${winner.robot} was the fastest: ${(others[0].time_s - winner.time_s).toFixed(1)} s ahead of ${others[0].robot}.`
      : `${winner.robot} was selected although ${others[0].robot} would have been faster in this role: all roles were assigned together.`;
  return make('p', { className: 'muted' }, text);
}

function offers(auction, role) {
  const rank = { bid: 0, unviable: 1, refused: 2, not_asked: 3 };
  const words = { refused: ['wait', 'refused'], not_asked: ['wait', 'not asked'], unviable: ['warn', 'not viable'] };
  const list = auction.offers.filter((offer) => offer.role === role);
  list.sort((a, b) => Number(b.chosen) - Number(a.chosen) || rank[a.verdict] - rank[b.verdict] || (a.time_s ?? 0) - (b.time_s ?? 0));
  const longest = Math.max(...list.map((offer) => offer.time_s ?? 0), 1);
  const body = make('tbody');
  for (const offer of list) {
    const row = make('tr', { className: offer.chosen ? 'won' : '' });
    const verdict = offer.chosen ? state('good', 'won') : offer.verdict === 'bid' ? state('work', 'bid') : state(...(words[offer.verdict] ?? words.unviable));
    const why = make('td', { className: 'wrap' }, verdict, offer.why ? make('span', { className: 'sub' }, offer.why) : null);
    const time = offer.time_s === undefined ? '–' : meter(offer.time_s / longest, `${offer.time_s.toFixed(1)} s`);
    cells(row, offer.robot, why, time, numberCell(offer.energy === undefined ? '–' : percent(offer.energy, 1)), numberCell(offer.remaining === undefined ? '–' : percent(offer.remaining, 1)));
    body.append(row);
    const details = parts(offer, role);
    if (details) body.append(make('tr', { className: offer.chosen ? 'more won' : 'more' }, make('td'), make('td', { colSpan: 4 }, details)));
  }
  const head = ['Robot', 'Answer', 'Time', 'Uses', 'Leaves'].map((text, index) => make('th', { scope: 'col', className: index > 2 ? 'number' : '' }, text));
  return make('table', { className: 'offers' }, make('caption', { className: 'unseen' }, `Answers for ${role}`), make('thead', {}, make('tr', {}, head)), body);
}

function parts(offer, role) {
  if (!offer.parts?.length) return null;
  const body = make('tbody', {}, offer.parts.map((part) => {
    const row = make('tr');
    cells(row, part.label, part.skill, numberCell(`${part.time.toFixed(1)} s`), numberCell(percent(part.energy, 2)));
    return row;
  }));
  const head = ['Step', 'Skill', 'Time', 'Charge'].map((text, index) => make('th', { scope: 'col', className: index > 1 ? 'number' : '' }, text));
  const table = make('table', { className: 'parts' }, make('caption', { className: 'unseen' }, `Parts of the bid of ${offer.robot}`), make('thead', {}, make('tr', {}, head)), body);
  const details = make('details', {}, make('summary', {}, `${offer.from ? `from ${offer.from}, ` : ''}in ${offer.parts.length} parts`), table);
  details.dataset.key = `parts-${role}-${offer.robot}`;
  details.firstChild.dataset.key = `open-${role}-${offer.robot}`;
  return details;
}
