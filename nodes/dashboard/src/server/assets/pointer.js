// Clicks, drags and pinches on the map.

/** Distance in pixels from which a press is a drag, and no click. */
const DRAG_MIN = 4;
/** Zoom for each step of a wheel. */
const ZOOM_WHEEL = 1.0015;

/**
 * Calls `onClick` with a position, `onDrag` with a distance while `canDrag()`, and `onZoom` with a factor and a
 * position, all in pixels of the element. A wheel alone scrolls the page: pinching a touchpad is a wheel with the control key.
 */
export function followPointer(element, { onClick, canDrag, onDrag, onZoom }) {
  element.addEventListener('wheel', (event) => {
    if (!event.ctrlKey) return;
    event.preventDefault();
    onZoom(ZOOM_WHEEL ** -event.deltaY, [event.offsetX, event.offsetY]);
  }, { passive: false });
  let drag;
  element.onpointerdown = (event) => { drag = { at: [event.clientX, event.clientY], moved: false }; };
  element.onpointermove = (event) => {
    if (!drag || !event.buttons || !canDrag()) return;
    const [dx, dy] = [event.clientX - drag.at[0], event.clientY - drag.at[1]];
    if (!drag.moved && Math.hypot(dx, dy) < DRAG_MIN) return;
    element.setPointerCapture(event.pointerId);
    drag = { at: [event.clientX, event.clientY], moved: true };
    onDrag(dx, dy);
  };
  element.onclick = (event) => {
    const wasDragged = drag?.moved;
    drag = undefined;
    if (!wasDragged) onClick(event.offsetX, event.offsetY);
  };
}
