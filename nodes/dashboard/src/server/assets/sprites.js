// Sprites of robots, painted once for each appearance and heading: copying hundreds of sprites
// takes as long as painting a few robots.

const HEADINGS = 32;

/**
 * Creates a sheet of sprites with `reach` pixels from their centre. `paint(pen, look, x, y, yaw)`
 * paints a sprite.
 */
export function sheet(looks, reach, ratio, paint) {
  const cell = Math.ceil(reach) * 2;
  const canvas = document.createElement('canvas');
  canvas.width = Math.ceil(cell * HEADINGS * ratio);
  canvas.height = Math.ceil(cell * looks.length * ratio);
  const pen = canvas.getContext('2d');
  pen.scale(ratio, ratio);
  for (const [row, look] of looks.entries()) {
    for (let column = 0; column < HEADINGS; column += 1) {
      paint(pen, look, (column + 0.5) * cell, (row + 0.5) * cell, (column / HEADINGS) * Math.PI * 2);
    }
  }
  const whole = (value) => Math.round(value * ratio) / ratio;
  return {
    stamp(pen, look, x, y, yaw) {
      const turn = Math.round((yaw / (Math.PI * 2)) * HEADINGS) % HEADINGS;
      const column = (turn + HEADINGS) % HEADINGS;
      const side = cell * ratio;
      pen.drawImage(canvas, column * side, looks.indexOf(look) * side, side, side, whole(x - cell / 2), whole(y - cell / 2), cell, cell);
    },
  };
}
