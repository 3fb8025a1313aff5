import { login, type Session } from "../api.ts";
import { button, el, say } from "../dom.ts";
import { sentenceOf } from "./view.ts";

/** The form of the login; `done` gets the session. */
export function showLogin(root: HTMLElement, done: (session: Session) => void): void {
  const user = el("input", { name: "user", autocomplete: "username", required: true, maxlength: 64, autofocus: true });
  const password = el("input", {
    name: "password",
    type: "password",
    autocomplete: "current-password",
    required: true,
    maxlength: 256,
  });
  const wrong = el("p", { class: "wrong", role: "alert" });
  const send = button("Log in", () => undefined, { type: "submit" });
  const form = el(
    "form",
    { class: "login panel", submit: (event) => void submit(event) },
    el("h1", {}, "Log in"),
    el("label", {}, "User", user),
    el("label", {}, "Password", password),
    send,
    wrong,
    el("p", { class: "quiet" }, "midspan run printed the first password, of the user admin, once at its first start."),
  );

  async function submit(event: Event): Promise<void> {
    event.preventDefault();
    send.disabled = true;
    say(wrong, "");
    try {
      done(await login(user.value, password.value));
    } catch (error) {
      say(wrong, sentenceOf(error));
      password.select();
    } finally {
      send.disabled = false;
    }
  }

  root.replaceChildren(form);
  user.focus();
}
