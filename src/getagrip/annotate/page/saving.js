// Changes on their way to the server. They are kept in the browser until it has answered, and sent in order, so that a
// reload, a closed tab or a server that is away for a while loses none. The server takes each one once.

const KEY = "getagrip-unsaved";

export const fresh = () => crypto.randomUUID();

// A tab keeps its name over reloads: undo takes back what was done in this tab.
export const tab = sessionStorage.getItem("getagrip-tab") ?? fresh();
sessionStorage.setItem("getagrip-tab", tab);

export class Saving {
  /** `onAnswer(path, sent, answer)`, `onRefused(text)`, `onPending(count)` tell the page how it goes. */
  constructor(onAnswer, onRefused, onPending) {
    Object.assign(this, { onAnswer, onRefused, onPending });
    this.sending = null;
  }

  get waiting() {
    return Object.keys(localStorage).filter((key) => key.startsWith(`${KEY}:`)).sort();
  }

  /** Send what follows all that was given before. */
  add(path, content) {
    // Keys sort by time, so that what an earlier page left behind goes first.
    const order = `${String(Date.now()).padStart(15, "0")}-${String(this.count = (this.count ?? 0) + 1).padStart(6, "0")}`;
    localStorage.setItem(`${KEY}:${order}-${content.change}`, JSON.stringify({ path, content }));
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
      } catch {
        this.onPending(keys.length, true);
        setTimeout(() => this.flush(), 2000);
        return;
      }
      localStorage.removeItem(keys[0]);
      if (answer.ok) this.onAnswer(path, content, body);
      else this.onRefused(body.error, content);
    }
    this.onPending(0);
  }
}
