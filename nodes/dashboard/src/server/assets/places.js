// Places, lanes and zones of the map, as orders name them.

/** Returns the name of the lane between two places, the same in both directions. */
export const laneName = (a, b) => (a < b ? `${a} – ${b}` : `${b} – ${a}`);

/** Returns the name of a place, a lane or a zone in an order. */
export const partName = ({ zone, place, lane }) => (zone ? `zone ${zone.name}` : place ?? laneName(...lane));

/** Returns the places of zones by their names in orders: of the zones of the fleet file, and of those in limits and closures. */
export const zonePlaces = ({ zones = {}, speed_limits: limits = {}, closures = {} }) => new Map([
  ...Object.entries(zones).map(([name, places]) => [partName({ zone: { name } }), places]),
  ...[...Object.values(limits), ...Object.values(closures)].filter(({ part }) => part.zone).map(({ part }) => [partName(part), part.zone.places]),
]);

/** Returns the places of a part of an order: those of a zone, or the place; none for a lane. */
export const placesOf = ({ zone, place }) => zone?.places ?? (place === undefined ? [] : [place]);

/** Returns the names of the lanes that people or alarms have closed, and of the closed places, also of those in closed zones. */
export function closedNames({ closures = {}, alarms = {} }) {
  const parts = [...Object.values(closures).map(({ part }) => part), ...Object.values(alarms).flatMap(({ plan }) => plan.closes)];
  return new Set(parts.flatMap((part) => (part.lane ? [partName(part)] : placesOf(part))));
}

/** Returns the assembly places of the alarms in force; none while an alarm lets all robots stand still. */
export function assemblyPlaces({ alarms = {} }) {
  const plans = Object.values(alarms).map(({ plan }) => plan);
  return new Set(plans.every(({ robots }) => robots === 'assemble') ? plans.flatMap(({ places }) => places) : []);
}

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
