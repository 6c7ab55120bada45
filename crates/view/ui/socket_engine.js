// The engine behind a WebSocket: the program that serves this page.

/** Milliseconds before another try when the connection is lost. */
const RETRY = 1000;

/** Opens the connection; it comes back by itself when it is lost. */
export function openSocketEngine() {
  /** @type {import("./types").ViewEngine} */
  const engine = { send, onpatch: () => {}, onmessage: () => {}, onopen: () => {}, onlost: () => {} };
  const address = new URL("socket", location.href);
  address.protocol = "ws:";
  address.hash = "";
  /** @type {WebSocket | null} */
  let socket = null;

  function connect() {
    socket = new WebSocket(address);
    socket.binaryType = "arraybuffer";
    socket.onopen = () => engine.onopen();
    socket.onmessage = ({ data }) => {
      if (typeof data === "string") engine.onmessage(JSON.parse(data));
      else engine.onpatch(data);
    };
    socket.onclose = () => {
      engine.onlost();
      setTimeout(connect, RETRY);
    };
  }

  /** @param {import("./types").ViewerEvent} event */
  function send(event) {
    if (socket?.readyState === WebSocket.OPEN) socket.send(JSON.stringify(event));
  }

  // After the caller has set what is to be done.
  setTimeout(connect, 0);
  return engine;
}
