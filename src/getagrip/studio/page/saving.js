// Changes on their way to the server. They are kept in the browser until it has answered, and sent in order, so that a
// reload, a closed tab or a server that is away for a while loses none. The server takes each one once. Each database of
// marks has its own queue: a server that has another one open is as good as away.

const KEY = "getagrip-unsaved";

/** What is thrown where the server is not reached: the page says so beside "saved", and ends it by itself. */
export class Away extends Error {}

export const fresh = () => crypto.randomUUID();

// A tab keeps its name over reloads: undo takes back what was done in this tab.
export const tab = sessionStorage.getItem("getagrip-tab") ?? fresh();
sessionStorage.setItem("getagrip-tab", tab);

export class Saving {
  /** `onAnswer(path, sent, answer)`, `onRefused(text)`, `onPending(count)` report progress to the page. */
  constructor(onAnswer, onRefused, onPending) {
    Object.assign(this, { onAnswer, onRefused, onPending });
    this.sending = null;
    this.project = null; // what the server calls the database that the changes are for
  }

  get waiting() {
    return Object.keys(localStorage).filter((key) => key.startsWith(`${KEY}:${this.project}:`)).sort();
  }

  /** Send what follows all that was given before. */
  add(path, content) {
    // Keys sort by time, so that entries of an earlier page go first.
    const order = `${String(Date.now()).padStart(15, "0")}-${String(this.count = (this.count ?? 0) + 1).padStart(6, "0")}`;
    const sent = { path, content: { ...content, project: this.project } };
    localStorage.setItem(`${KEY}:${this.project}:${order}-${content.change}`, JSON.stringify(sent));
    this.onPending(this.waiting.length);
    return this.flush();
  }

  flush() {
    this.sending ??= this.send().finally(() => { this.sending = null; });
    return this.sending;
  }

  async send() {
    for (let keys = this.waiting; keys.length; keys = this.waiting) {
      const text = localStorage.getItem(keys[0]);
      if (text === null) continue; // another tab has sent it
      const { path, content } = JSON.parse(text);
      let answer, body;
      try {
        answer = await fetch(path, { method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify(content) });
        body = await answer.json();
        if (answer.status === 503 || answer.status === 401) throw new Error(body.error); // away, or not to be entered by this page
      } catch (error) {
        this.onPending(keys.length, answer ? error.message : "the server is not reached");
        setTimeout(() => this.flush(), 1000);
        return;
      }
      localStorage.removeItem(keys[0]);
      if (answer.ok) this.onAnswer(path, content, body);
      else this.onRefused(body.error, content);
    }
    this.onPending(0);
  }
}
