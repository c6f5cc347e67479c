// The line to the node: a WebSocket that brings the whole picture first, and then what has changed (RFC 7396). When it
// breaks, that is said, and it is tried again, more and more patiently.

const PATIENCE = { least: 250, most: 8000 };
// The node says something once in a second, whatever happens: silence for longer is a broken line that nobody has noticed.
const SILENCE = 5000;

/** `ready` is awaited before each attempt: it ends when there is a point in one. */
export function open({ onChange, onLine, ready }) {
  // What was heard is counted, to be looked at by tests.
  const heardOf = { number: 0, wholes: 0, patches: 0, bytes: 0 };
  const line = { picture: null, said: 0, saidAt: 0, state: 'connecting', since: Date.now(), heard: heardOf };
  // Of a recording time passes as it is played; otherwise as it does.
  line.pace = () => {
    const recording = line.picture?.recording;
    return recording ? (recording.playing ? recording.speed : 0) : 1;
  };
  line.now = () => line.said + (Date.now() - line.saidAt) * line.pace();
  let wait = PATIENCE.least;
  let heard = Date.now();

  const enter = (state) => {
    if (state !== line.state) {
      line.state = state;
      line.since = Date.now();
    }
    onLine(line);
  };

  const connect = async () => {
    await ready();
    const socket = new WebSocket(`${location.protocol === 'https:' ? 'wss' : 'ws'}://${location.host}/ws`);
    heard = Date.now();
    const watch = setInterval(() => {
      if (Date.now() - heard > SILENCE) socket.close();
    }, 1000);
    socket.onmessage = ({ data }) => {
      const said = JSON.parse(data);
      heard = Date.now();
      Object.assign(line, { said: said.now_ms, saidAt: heard });
      wait = PATIENCE.least;
      heardOf.number = said.number;
      heardOf.bytes += data.length;
      if (said.whole) {
        heardOf.wholes += 1;
        line.picture = said.whole;
        enter('open');
        onChange(line.picture, null);
      } else if (said.patch) {
        heardOf.patches += 1;
        merge(line.picture, said.patch);
        onChange(line.picture, said.patch);
      }
    };
    socket.onclose = () => {
      clearInterval(watch);
      enter('broken');
      // A little chance, so that many pages do not come back at one moment.
      setTimeout(connect, wait * (0.75 + Math.random() / 2));
      wait = Math.min(wait * 2, PATIENCE.most);
    };
  };
  connect();
  return line;
}

/** Changes a value by a merge patch. */
export function merge(value, patch) {
  for (const [name, change] of Object.entries(patch)) {
    if (change === null) delete value[name];
    else if (isObject(change) && isObject(value[name])) merge(value[name], change);
    else value[name] = isObject(change) ? merge({}, change) : change;
  }
  return value;
}

const isObject = (value) => typeof value === 'object' && value !== null && !Array.isArray(value);
