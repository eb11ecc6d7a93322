// Where the feed comes from: a run that goes on, a record of the server, or the page itself when it plays offline.

import type { Command, Message, Scene, Update } from "./messages";
import { Replay, type Session } from "./session";
import { unzip } from "./wire";

const FIRST_RETRY = 500;
const LONGEST_RETRY = 8000;

export interface Steering {
  send(command: Command): void;
}

const TOKEN = "covey.token";
/** WebSocket's close code for those who break the rules. */
const TURNED_AWAY = 1008;

/** Token of this visitor; from the address once, then from the tab's memory, so that a copied address does not carry it. */
function takeToken(): { token: string; given: boolean } {
  const parameters = new URLSearchParams(location.hash.slice(1));
  const given = parameters.get("token");
  try {
    if (given === null) return { token: sessionStorage.getItem(TOKEN) ?? "", given: false };
    sessionStorage.setItem(TOKEN, given);
    parameters.delete("token");
    const rest = parameters.toString().replace(/=(?=&|$)/g, "");
    history.replaceState(null, "", location.pathname + location.search + (rest ? `#${rest}` : ""));
  } catch {
    // without storage the address keeps it
  }
  return { token: given ?? "", given: given !== null };
}

function forgetToken(): void {
  try {
    sessionStorage.removeItem(TOKEN);
  } catch {
    // nothing was stored
  }
}

/** Begin to fill the session; returns the way to send commands. */
export function open(session: Session, changed: () => void): Steering {
  const embedded = document.getElementById("covey-record");
  if (embedded) {
    session.hello = { type: "Hello", source: "record", may_steer: false, commands: [], speed: 1 };
    unzip((embedded.textContent ?? "").trim()).then(
      (text) => play(session, text, changed),
      (error: unknown) => fail(session, `The record in this file cannot be read: ${String(error)}`, changed),
    );
    return { send: () => undefined };
  }
  if (location.protocol === "file:") {
    fail(session, "This page holds no record. Write one that does with: covey replay RECORD --html FILE", changed);
    return { send: () => undefined };
  }
  return new Live(session, changed);
}

function fail(session: Session, text: string, changed: () => void): void {
  session.status = "failed";
  session.trouble = text;
  changed();
}

function play(session: Session, text: string, changed: () => void): void {
  const feed: (Scene | Update)[] = [];
  for (const line of text.split("\n")) if (line) feed.push(JSON.parse(line) as Scene | Update);
  if (feed.length === 0) {
    fail(session, "This record is empty.", changed);
    return;
  }
  session.replay = new Replay(session, feed);
  session.replay.seek(session.replay.start);
  changed();
}

class Live implements Steering {
  private socket: WebSocket | null = null;
  private token: string;
  /** Whether the token came with the address and no server has taken it yet. */
  private untried: boolean;
  private retry = FIRST_RETRY;

  constructor(
    private readonly session: Session,
    private readonly changed: () => void,
  ) {
    const { token, given } = takeToken();
    this.token = token;
    this.untried = given;
    this.connect();
  }

  send(command: Command): void {
    if (this.socket?.readyState !== WebSocket.OPEN) return;
    this.socket.send(JSON.stringify({ type: "command", token: this.token, ...command }));
  }

  private connect(): void {
    const address = new URL("api/feed", document.baseURI);
    address.protocol = address.protocol === "https:" ? "wss:" : "ws:";
    const socket = new WebSocket(address);
    this.socket = socket;
    socket.onopen = () => socket.send(JSON.stringify({ type: "hello", token: this.token }));
    socket.onmessage = (event: MessageEvent<string>) => {
      this.retry = FIRST_RETRY;
      this.untried = false;
      const messages = JSON.parse(event.data) as Message[];
      for (const message of messages) {
        this.session.receive(message);
        if (message.type === "Hello" && message.source === "record") {
          socket.onclose = null;
          socket.close();
          void this.load();
        }
      }
      this.changed();
    };
    socket.onclose = (event) => {
      if (event.code === TURNED_AWAY && this.token) {
        forgetToken();
        if (this.untried) {
          fail(this.session, "The server turned this page away: the token in its address is of another run. Open the address that the run prints.", this.changed);
          return;
        }
        this.token = ""; // of an earlier run: without it one may still watch
      }
      if (this.session.status !== "over") this.session.status = this.session.world ? "lost" : "connecting";
      this.changed();
      setTimeout(() => this.connect(), this.retry);
      this.retry = Math.min(2 * this.retry, LONGEST_RETRY);
    };
  }

  private async load(): Promise<void> {
    try {
      const response = await fetch("api/record");
      if (!response.ok) throw new Error(`the server answered ${response.status}`);
      play(this.session, await response.text(), this.changed);
    } catch (error) {
      fail(this.session, `The record cannot be loaded: ${String(error)}`, this.changed);
    }
  }
}
