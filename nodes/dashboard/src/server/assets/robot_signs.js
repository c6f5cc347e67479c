// Signs of robots and of groups of robots on the map.

const isOut = (robot) => !robot.alive || robot.availability === 'out_of_service' || robot.can_move === false;

export const LOOKS = ['busy', 'free', 'suspended', 'out'];

export const lookOf = (robot) => {
  if (isOut(robot)) return 'out';
  if (robot.orders?.hold) return 'suspended';
  return { holding: 'busy', suspended: 'suspended' }[robot.availability] ?? 'free';
};

/** Paints a robot of a look at a position in pixels. */
export function paintRobot(pen, colours, look, px, py, yaw, radius) {
  const colour = { out: colours.bad, suspended: colours.warn }[look] ?? colours.accent;
  // The nose shows the heading.
  pen.fillStyle = colour;
  pen.beginPath();
  pen.moveTo(px + Math.cos(yaw) * radius * 1.7, py - Math.sin(yaw) * radius * 1.7);
  pen.lineTo(px + Math.cos(yaw + 0.75) * radius, py - Math.sin(yaw + 0.75) * radius);
  pen.lineTo(px + Math.cos(yaw - 0.75) * radius, py - Math.sin(yaw - 0.75) * radius);
  pen.fill();
  pen.beginPath();
  pen.arc(px, py, radius, 0, 7);
  pen.fillStyle = look === 'busy' || look === 'suspended' ? colour : colours.floor;
  pen.fill();
  pen.strokeStyle = colour;
  pen.lineWidth = 2;
  if (look === 'out') pen.setLineDash([3, 3]);
  pen.stroke();
  pen.setLineDash([]);
}

/**
 * Paints a group of robots as a disc with their number, and with a rim if a robot of it is suspended or out of
 * service. Returns the radius of the disc in pixels.
 */
export function paintGroup(pen, colours, robots, px, py, radius) {
  const looks = new Set(robots.map(lookOf));
  const own = radius * 1.4 + Math.min(Math.sqrt(robots.length), radius);
  pen.fillStyle = colours.accent;
  pen.strokeStyle = looks.has('out') ? colours.bad : looks.has('suspended') ? colours.warn : colours.floor;
  pen.lineWidth = 2;
  pen.beginPath();
  pen.arc(px, py, own, 0, 7);
  pen.fill();
  pen.stroke();
  pen.font = '600 10px system-ui, sans-serif';
  pen.textAlign = 'center';
  pen.fillStyle = colours['on-accent'];
  pen.fillText(robots.length, px, py + 3.5);
  return own;
}
