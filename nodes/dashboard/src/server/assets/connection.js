// Connection to the node: a WebSocket that receives the full model first, and then changes (RFC
// 7396). A broken connection is reported, and retried with increasing delays.

const RETRY_DELAY = { least: 250, most: 8000 };
// The node sends a message at least once per second: a longer silence is an undetected broken
// connection.
const SILENCE_MAX = 5000;

/**
 * Opens the connection. `ready` is awaited before each attempt: it resolves when an attempt can
 * succeed.
 */
export function open({ onChange, onState, ready }) {
  // Counters of received messages, for tests.
  const received = { number: 0, fulls: 0, patches: 0, bytes: 0 };
  const connection = { model: null, nodeTime: 0, nodeTimeAt: 0, state: 'connecting', since: Date.now(), received };
  // The time of a recording passes at its playback speed.
  connection.rate = () => {
    const recording = connection.model?.recording;
    return recording ? (recording.playing ? recording.speed : 0) : 1;
  };
  connection.now = () => connection.nodeTime + (Date.now() - connection.nodeTimeAt) * connection.rate();
  let delay = RETRY_DELAY.least;
  let receivedAt = Date.now();

  const enter = (state) => {
    if (state !== connection.state) {
      connection.state = state;
      connection.since = Date.now();
    }
    onState(connection);
  };

  const connect = async () => {
    await ready();
    const socket = new WebSocket(`${location.protocol === 'https:' ? 'wss' : 'ws'}://${location.host}/ws`);
    receivedAt = Date.now();
    const watchdog = setInterval(() => {
      if (Date.now() - receivedAt > SILENCE_MAX) socket.close();
    }, 1000);
    socket.onmessage = ({ data }) => {
      const message = JSON.parse(data);
      receivedAt = Date.now();
      Object.assign(connection, { nodeTime: message.now_ms, nodeTimeAt: receivedAt });
      delay = RETRY_DELAY.least;
      received.number = message.number;
      received.bytes += data.length;
      if (message.full) {
        received.fulls += 1;
        connection.model = message.full;
        enter('open');
        onChange(connection.model, null);
      } else if (message.patch) {
        received.patches += 1;
        merge(connection.model, message.patch);
        onChange(connection.model, message.patch);
      }
    };
    socket.onclose = () => {
      clearInterval(watchdog);
      enter('broken');
      // Random jitter, so that many pages do not reconnect at the same moment.
      setTimeout(connect, delay * (0.75 + Math.random() / 2));
      delay = Math.min(delay * 2, RETRY_DELAY.most);
    };
  };
  connect();
  return connection;
}

/** Applies a merge patch to a value. */
export function merge(value, patch) {
  for (const [name, change] of Object.entries(patch)) {
    if (change === null) delete value[name];
    else if (isObject(change) && isObject(value[name])) merge(value[name], change);
    else value[name] = isObject(change) ? merge({}, change) : change;
  }
  return value;
}

const isObject = (value) => typeof value === 'object' && value !== null && !Array.isArray(value);
