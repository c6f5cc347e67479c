// Places, lanes and zones of the map, as closures name them.

/** Returns the name of the lane between two places, the same in both directions. */
export const laneName = (a, b) => (a < b ? `${a} – ${b}` : `${b} – ${a}`);

/** Returns the places of a part of a closure: those of a zone, or the place; none for a lane. */
export const placesOf = ({ zone, place }) => zone?.places ?? (place === undefined ? [] : [place]);

/** Returns the names of the closed lanes, and of the closed places, also of those in closed zones. */
export const closedNames = (closures = {}) =>
  new Set(Object.entries(closures).flatMap(([name, { part }]) => (part.lane ? [name] : placesOf(part))));

/**
 * Returns the places that can be reached from others along lanes without entering a closed place or
 * lane. A closed place may be left.
 */
export function reachable(lanes, from, closed) {
  const reached = new Set(from);
  // The loop also visits the places that it adds.
  for (const place of reached) {
    for (const { between: [a, b], one_way: oneWay } of lanes) {
      const next = a === place ? b : b === place && !oneWay ? a : undefined;
      if (next !== undefined && !closed.has(next) && !closed.has(laneName(a, b))) reached.add(next);
    }
  }
  return reached;
}
