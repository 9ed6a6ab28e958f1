// The operator's devices: keyboard, touch buttons and gamepad become two axes, advance and rotate, each -1 to 1.

const KEYS = {
  ArrowUp: "up", KeyW: "up", ArrowDown: "down", KeyS: "down",
  ArrowLeft: "left", KeyA: "left", ArrowRight: "right", KeyD: "right",
  Shift: "slow", ShiftLeft: "slow", ShiftRight: "slow",
};
const SLOW = 0.25;
const DEAD_ZONE = 0.15; // of a stick
const HEARTBEAT = 200; // ms; the console lets go of the wire when it hears nothing for 0.6 s

export class Controls {
  // `send(advance, rotate)` is called at every change and, while something is held, as a heartbeat;
  // `tell(text, kind)` shows a sentence; `device(name)` says what is plugged in.
  constructor({ send, tell, device }) {
    this.send = send;
    this.tell = tell;
    this.device = device;
    this.enabled = true;
    this.held = new Map(); // action -> the keys and buttons that hold it
    this.pad = null;
    this.padAxes = [0, 0];
    this.last = [0, 0];

    addEventListener("keydown", (event) => this.#key(event, true));
    addEventListener("keyup", (event) => this.#key(event, false));
    addEventListener("blur", () => this.release());
    document.addEventListener("visibilitychange", () => document.hidden && this.release());
    addEventListener("gamepadconnected", (event) => this.#plugged(event.gamepad));
    addEventListener("gamepaddisconnected", (event) => this.#pulled(event.gamepad));
    for (const button of document.querySelectorAll("#pad button")) this.#touch(button);
    setInterval(() => this.last.some(Boolean) && this.send(...this.last), HEARTBEAT);
    const poll = () => { this.#pollPad(); requestAnimationFrame(poll); };
    requestAnimationFrame(poll);
  }

  release() {
    this.held.clear();
    this.padAxes = [0, 0];
    for (const button of document.querySelectorAll("#pad button")) button.classList.remove("held");
    this.#changed();
  }

  enable(enabled) {
    this.enabled = enabled;
    if (!enabled) this.release();
  }

  #key(event, down) {
    const action = KEYS[event.code];
    if (!action || event.ctrlKey || event.altKey || event.metaKey) return;
    if (!this.enabled) return;
    if (event.target.closest?.("select, input, textarea")) return;
    if (action !== "slow") event.preventDefault();
    if (event.repeat) return;
    this.#hold(action, event.code, down);
  }

  #touch(button) {
    const action = KEYS[button.dataset.key];
    const set = (down) => (event) => {
      event.preventDefault();
      if (down && !this.enabled) return;
      if (down) button.setPointerCapture?.(event.pointerId);
      button.classList.toggle("held", down);
      this.#hold(action, `button ${action}`, down);
    };
    button.addEventListener("pointerdown", set(true));
    for (const kind of ["pointerup", "pointercancel", "lostpointercapture"]) button.addEventListener(kind, set(false));
    button.addEventListener("contextmenu", (event) => event.preventDefault());
    button.tabIndex = -1; // the arrow keys do the same, and space would press it without ever letting go
  }

  #hold(action, source, down) {
    const sources = this.held.get(action) ?? new Set();
    down ? sources.add(source) : sources.delete(source);
    sources.size ? this.held.set(action, sources) : this.held.delete(action);
    this.#changed();
  }

  #plugged(pad) {
    this.pad = pad.index;
    this.device("gamepad");
    this.tell(`Gamepad connected: ${pad.id.split("(")[0].trim() || "unnamed"}`);
  }

  #pulled(pad) {
    if (this.pad !== null && pad.index !== this.pad) return;
    this.#lost();
  }

  #lost() {
    this.pad = null;
    this.device("");
    this.release();
    this.send(0, 0);
    this.tell("The gamepad was pulled out: the controls are released. Plug it in again, or go on with the keys.", "error");
  }

  #pollPad() {
    if (this.pad === null) return;
    const pad = navigator.getGamepads()[this.pad];
    if (!pad || !pad.connected) { this.#lost(); return; } // some browsers send no event
    const dead = (x) => (Math.abs(x) < DEAD_ZONE ? 0 : Math.sign(x) * (Math.abs(x) - DEAD_ZONE) / (1 - DEAD_ZONE));
    const pressed = (k) => (pad.buttons[k]?.pressed ? 1 : 0);
    const slow = pressed(4) || pressed(5) || pressed(6) || pressed(7) ? SLOW : 1;
    const advance = -dead(pad.axes[1] ?? 0) + pressed(12) - pressed(13);
    const rotate = dead(pad.axes[0] ?? 0) + pressed(15) - pressed(14);
    this.padAxes = this.enabled ? [advance * slow, rotate * slow] : [0, 0];
    this.#changed();
  }

  #changed() {
    const on = (action) => (this.held.has(action) ? 1 : 0);
    const speed = on("slow") ? SLOW : 1;
    const limit = (x) => Math.round(Math.max(-1, Math.min(1, x)) * 100) / 100;
    const advance = limit((on("up") - on("down")) * speed + this.padAxes[0]);
    const rotate = limit((on("right") - on("left")) * speed + this.padAxes[1]);
    if (advance === this.last[0] && rotate === this.last[1]) return;
    this.last = [advance, rotate];
    this.send(advance, rotate);
  }
}
