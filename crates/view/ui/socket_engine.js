// The engine behind a WebSocket: the program that serves this page.

/** Milliseconds before another try when the connection is lost. */
const RETRY = 1000;

/** Milliseconds in which a program that is there says so. */
const ANSWER = 3000;

/**
 * Why there is no connection. A WebSocket does not tell; whoever serves this page does.
 * @param {boolean} opened it was there before
 */
async function reasonOfLoss(opened) {
  const page = location.href.split("#")[0];
  const status = await fetch(page, { cache: "no-store", signal: AbortSignal.timeout(ANSWER) }).then((answer) => answer.status, () => 0);
  if (status === 403) return "this address belongs to an earlier viewer: open the one that the program printed";
  // The page itself is never refused for that, only the connection.
  if (status === 503 || (status === 200 && !opened)) return "too many viewers are open; waiting";
  return status === 200 ? "the connection was lost; trying again" : "the viewer is not running any more; waiting for it";
}

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
    let opened = false;
    socket = new WebSocket(address);
    socket.binaryType = "arraybuffer";
    socket.onopen = () => {
      opened = true;
      engine.onopen();
    };
    socket.onmessage = ({ data }) => {
      if (typeof data === "string") engine.onmessage(JSON.parse(data));
      else engine.onpatch(data);
    };
    socket.onclose = async () => {
      engine.onlost(await reasonOfLoss(opened));
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
