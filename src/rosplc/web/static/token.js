// The token: taken from the address after #, or typed; it stays in this tab.

const KEY = "rosplc.token";

/** Remove the token from the address, so that no bookmark or screenshot contains it. */
export function takeFromAddress() {
  const found = /^#token=([!-~]+)$/.exec(location.hash);
  if (!found) return;
  keep(found[1]);
  history.replaceState(null, "", "#/channels");
}

/** The token, or an empty text. */
export function token() {
  try {
    return sessionStorage.getItem(KEY) ?? "";
  } catch {
    return memory;
  }
}

let memory = "";

/** Remember a token until the tab is closed. */
export function keep(text) {
  memory = text;
  try {
    sessionStorage.setItem(KEY, text);
  } catch {
    // The browser may forbid storage; then the token is kept until the page is closed.
  }
}

/** Send a request to the server, with the token if there is one; returns its JSON, or throws its error. */
export async function ask(path, body = null) {
  const headers = {};
  if (token()) headers.Authorization = `Bearer ${token()}`;
  const options = { headers, cache: "no-store" };
  if (body !== null) {
    options.method = "POST";
    options.body = JSON.stringify(body);
    headers["Content-Type"] = "application/json";
  }
  let response;
  try {
    response = await fetch(path, options);
  } catch {
    throw { code: "", what: "the server is not responding", where: "", remedy: "Check that rosplc web is still running." };
  }
  let answer = {};
  try {
    answer = await response.json();
  } catch {
    // A response that is not JSON is an error without a text.
  }
  if (!response.ok) {
    throw answer.error ?? { code: "", what: `the server returned status ${response.status}`, where: "", remedy: "" };
  }
  return answer;
}
