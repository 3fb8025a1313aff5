// Elements of the page. Text goes in as text nodes: names with markup are shown, never read as markup.

type Child = Node | string | null | undefined | false;
type Attributes = Record<string, string | number | boolean | null | undefined | ((event: Event) => void)>;

/** An element with attributes and children; a function is a listener of the event that its name says. */
export function el<K extends keyof HTMLElementTagNameMap>(
  tag: K,
  attributes: Attributes = {},
  ...children: Child[]
): HTMLElementTagNameMap[K] {
  const made = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (typeof value === "function") made.addEventListener(name, value);
    else if (value === true) made.setAttribute(name, "");
    else if (value !== false && value !== null && value !== undefined) made.setAttribute(name, String(value));
  }
  for (const child of children) if (child) made.append(child);
  return made;
}

/** Change a text only where it differs, so that a screen reader and a selection are left alone. */
export function say(element: HTMLElement, text: string): void {
  if (element.textContent !== text) element.textContent = text;
}

/** Change a class that stands for a state. */
export function mark(element: HTMLElement, state: string): void {
  if (element.dataset["state"] !== state) element.dataset["state"] = state;
}

/** A labelled choice; `chosen` is called with its value. */
export function choice(
  label: string,
  options: [value: string, text: string][],
  value: string,
  chosen: (value: string) => void,
): HTMLLabelElement {
  const select = el("select", { change: () => chosen(select.value) });
  for (const [key, text] of options) select.append(el("option", { value: key, selected: key === value }, text));
  return el("label", {}, label, " ", select);
}

export function button(text: string, pressed: () => void, attributes: Attributes = {}): HTMLButtonElement {
  return el("button", { type: "button", click: pressed, ...attributes }, text);
}

/** Disable buttons for a reason, which they show; enable them without one. */
export function disable(buttons: HTMLButtonElement[], reason: string): void {
  for (const one of buttons) {
    one.disabled = reason !== "";
    one.title = reason;
  }
}

/** A table that becomes a list on a phone; `rows` is filled by its view, see `line`. */
export function table(columns: string[], rows: HTMLTableSectionElement): HTMLElement {
  const head = el("thead", {}, el("tr", {}, ...columns.map((text) => el("th", { scope: "col" }, text))));
  return el("div", { class: "wide" }, el("table", { class: "stacked" }, head, rows));
}

/** A line of such a table. */
export function line(columns: string[], texts: string[]): HTMLTableRowElement {
  return el("tr", {}, ...texts.map((text, at) => el("td", { "data-name": columns[at] ?? "" }, text)));
}
