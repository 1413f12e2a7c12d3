// The WebSocket: sends the page's requests, receives data, and reconnects when the server is back.

import { store } from "./store.js";
import { token } from "./token.js";

const FIRST_PAUSE_MS = 500;
const LONGEST_PAUSE_MS = 5000;
const SILENCE_MS = 8000; // pictures arrive twice per second: after this time without one, the connection is dead

let socket = null;
let pauseMs = FIRST_PAUSE_MS;
let timer = 0;
let wants = { messages: [], plots: {} };
let lastFrame = 0;

/** Connect now, and again whenever the connection is lost. */
export function connect() {
  clearTimeout(timer);
  if (socket) return;
  const scheme = location.protocol === "https:" ? "wss:" : "ws:";
  const opened = new WebSocket(`${scheme}//${location.host}/api/live`);
  socket = opened;
  opened.addEventListener("open", () => {
    lastFrame = Date.now();
    opened.send(JSON.stringify({ token: token(), wants }));
  });
  opened.addEventListener("message", (event) => {
    if (socket === opened) take(JSON.parse(event.data));
  });
  opened.addEventListener("close", () => {
    if (socket === opened) lost();
  });
}

/** Tell the server what the page shows now. */
export function want(messages, plots) {
  const next = { messages, plots };
  if (JSON.stringify(next) === JSON.stringify(wants)) return;
  wants = next;
  if (socket?.readyState === WebSocket.OPEN) socket.send(JSON.stringify({ wants }));
}

/** Connect again, with another token. */
export function reconnect() {
  const old = socket;
  socket = null;
  old?.close();
  connect();
}

function take(frame) {
  lastFrame = Date.now();
  if (frame.error) {
    store.say("refused", frame.error);
    return;
  }
  if (frame.hello) {
    pauseMs = FIRST_PAUSE_MS;
    store.begin(frame.hello);
    store.setLink("live");
    return;
  }
  store.take(frame);
}

function lost() {
  socket = null;
  if (store.link === "locked") return; // without a token, another attempt is useless
  store.setLink("lost");
  timer = setTimeout(connect, pauseMs);
  pauseMs = Math.min(LONGEST_PAUSE_MS, pauseMs * 1.6);
}

setInterval(() => {
  if (socket?.readyState === WebSocket.OPEN && Date.now() - lastFrame > SILENCE_MS) {
    const old = socket;
    lost();
    old.close();
  }
}, 1000);

// When a tablet wakes up or the network is back, reconnect without waiting for the next attempt.
for (const [target, kind] of [[window, "online"], [document, "visibilitychange"]]) {
  target.addEventListener(kind, () => {
    if (!socket && !document.hidden) connect();
  });
}
