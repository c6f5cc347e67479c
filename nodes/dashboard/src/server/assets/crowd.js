// Groups of robots that are too near each other to be told apart on the map.

/** Robots that make a group, if they are in a square of this many radii of a robot. */
const [ROBOTS_MIN, SQUARE_RADII] = [4, 4];

/**
 * Divides robots into those drawn one by one and groups. `poses` are lists of a name, a robot and its pose in metres;
 * `side` is the side of a square in metres. The squares belong to the plan, so that a group does not change while the map is moved.
 * The robot `chosen` is never in a group.
 */
export function grouped(poses, side, chosen) {
  const squares = new Map();
  for (const pose of poses) {
    const [name, , [x, y]] = pose;
    // A number for each square; plans are smaller than a million squares.
    const square = name === chosen ? -1 : (Math.floor(x / side) + 1e6) * 1e7 + Math.floor(y / side) + 1e6;
    const found = squares.get(square);
    if (found) found.push(pose);
    else squares.set(square, [pose]);
  }
  const [single, groups] = [[], []];
  for (const [square, found] of squares) {
    if (square === -1 || found.length < ROBOTS_MIN) single.push(...found);
    else groups.push(found);
  }
  return { single, groups: groups.map((robots) => ({ robots, x: mean(robots, 0), y: mean(robots, 1) })) };
}

/** Returns the side of a square in pixels, for robots of a radius in pixels. */
export const sideOf = (radius) => radius * SQUARE_RADII;

const mean = (robots, axis) => robots.reduce((sum, [, , pose]) => sum + pose[axis], 0) / robots.length;
