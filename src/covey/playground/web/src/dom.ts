// Short hands for the document.

export function element<T extends HTMLElement>(id: string): T {
  const found = document.getElementById(id);
  if (!found) throw new Error(`the page has no element #${id}`);
  return found as T;
}

type Child = Node | string | null | undefined | false;

export function make<K extends keyof HTMLElementTagNameMap>(
  tag: K, attributes: Record<string, string> = {}, ...children: Child[]
): HTMLElementTagNameMap[K] {
  const made = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
  for (const child of children) if (child) made.append(child);
  return made;
}

/** Set a text only where it differs, which is cheaper than to lay the page out anew. */
export function setText(target: Element, text: string): void {
  if (target.textContent !== text) target.textContent = text;
}

export function button(label: string, title: string, action: () => void, icon?: string): HTMLButtonElement {
  const made = make("button", { type: "button", title });
  if (icon) made.append(svg(icon), make("span", { class: "sr" }, label));
  else made.append(label);
  made.addEventListener("click", action);
  return made;
}

export function svg(path: string, box = "0 0 20 20"): SVGSVGElement {
  const made = document.createElementNS("http://www.w3.org/2000/svg", "svg");
  made.setAttribute("viewBox", box);
  made.setAttribute("aria-hidden", "true");
  const line = document.createElementNS("http://www.w3.org/2000/svg", "path");
  line.setAttribute("d", path);
  made.append(line);
  return made;
}

const NO_VALUE = "–";

export function number(value: number, digits: number): string {
  return Number.isFinite(value) ? value.toFixed(digits).replace("-", "−") : NO_VALUE;
}

export function percent(value: number): string {
  return Number.isFinite(value) ? `${Math.round(100 * value)} %` : NO_VALUE;
}

export function clock(seconds: number): string {
  if (!Number.isFinite(seconds)) return NO_VALUE;
  if (seconds < 60) return `${seconds.toFixed(1)} s`;
  const whole = Math.floor(seconds);
  const [h, m, s] = [Math.floor(whole / 3600), Math.floor(whole / 60) % 60, whole % 60];
  const two = (value: number): string => String(value).padStart(2, "0");
  return h ? `${h}:${two(m)}:${two(s)}` : `${m}:${two(s)}`;
}

/** What the browser remembers for this page; nothing where it may not. */
export const memory = {
  get(key: string): string | null {
    try {
      return localStorage.getItem(`covey.${key}`);
    } catch {
      return null;
    }
  },
  set(key: string, value: string): boolean {
    try {
      localStorage.setItem(`covey.${key}`, value);
      return true;
    } catch {
      return false;
    }
  },
};
