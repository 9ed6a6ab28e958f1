// The operator's devices: keyboard, touch buttons and gamepad become two axes of the wire, advance and rotate, and two of
// the catheter, each -1 to 1. The right hand (arrows, right stick) steers the wire; the left hand (W A S D, left stick or
// cross) the catheter, or the wire where there is no catheter.

const RIGHT = 0, LEFT = 1;
// code: hand, axis (0 advance, 1 rotate), direction
const KEYS = {
  ArrowUp: [RIGHT, 0, 1], ArrowDown: [RIGHT, 0, -1], ArrowLeft: [RIGHT, 1, -1], ArrowRight: [RIGHT, 1, 1],
  KeyW: [LEFT, 0, 1], KeyS: [LEFT, 0, -1], KeyA: [LEFT, 1, -1], KeyD: [LEFT, 1, 1],
  ShiftLeft: "slow", ShiftRight: "slow",
};
const SLOW = 0.25;
const DEAD_ZONE = 0.15; // of a stick
const HEARTBEAT = 200; // ms; the console lets go of the devices when it hears nothing for 0.6 s

export class Controls {
  // `send(axes)` is called with the four axes, the wire's first, at every change and, while something is held, as a
  // heartbeat; `tell(text, kind)` shows a sentence; `device(name)` says what is plugged in.
  constructor({ send, tell, device }) {
    this.send = send;
    this.tell = tell;
    this.device = device;
    this.enabled = true;
    this.devices = 1; // 2: there is a catheter
    this.held = new Map(); // key's code -> what holds it, keyboard and button
    this.pad = null;
    this.padAxes = [0, 0, 0, 0]; // with the speed in them
    this.last = [0, 0, 0, 0];

    addEventListener("keydown", (event) => this.#key(event, true));
    addEventListener("keyup", (event) => this.#key(event, false));
    addEventListener("blur", () => this.release());
    document.addEventListener("visibilitychange", () => document.hidden && this.release());
    addEventListener("gamepadconnected", (event) => this.#plugged(event.gamepad));
    addEventListener("gamepaddisconnected", (event) => this.#pulled(event.gamepad));
    for (const button of document.querySelectorAll(".pad button")) this.#touch(button);
    setInterval(() => this.last.some(Boolean) && this.send(this.last), HEARTBEAT);
    const poll = () => { this.#pollPad(); requestAnimationFrame(poll); };
    requestAnimationFrame(poll);
  }

  release() {
    this.held.clear();
    this.padAxes = [0, 0, 0, 0];
    for (const button of document.querySelectorAll(".pad button")) button.classList.remove("held");
    this.#changed();
  }

  // How many devices are steered from now on; what is held is let go of.
  steer(devices) {
    if (devices === this.devices) return;
    this.release();
    this.devices = devices;
  }

  enable(enabled) {
    this.enabled = enabled;
    if (!enabled) this.release();
  }

  #key(event, down) {
    if (!KEYS[event.code] || event.ctrlKey || event.altKey || event.metaKey) return;
    if (!this.enabled) return;
    if (event.target.closest?.("select, input, textarea")) return;
    if (KEYS[event.code] !== "slow") event.preventDefault();
    if (event.repeat) return;
    this.#hold(event.code, "key", down);
  }

  #touch(button) {
    const set = (down) => (event) => {
      event.preventDefault();
      if (down && !this.enabled) return;
      if (down) button.setPointerCapture?.(event.pointerId);
      button.classList.toggle("held", down);
      this.#hold(button.dataset.key, "button", down);
    };
    button.addEventListener("pointerdown", set(true));
    for (const kind of ["pointerup", "pointercancel", "lostpointercapture"]) button.addEventListener(kind, set(false));
    button.addEventListener("contextmenu", (event) => event.preventDefault());
    button.tabIndex = -1; // the keys do the same, and space would press it without ever letting go
  }

  #hold(code, source, down) {
    const sources = this.held.get(code) ?? new Set();
    down ? sources.add(source) : sources.delete(source);
    sources.size ? this.held.set(code, sources) : this.held.delete(code);
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
    this.send([0, 0, 0, 0]);
    this.tell("The gamepad was pulled out: the controls are released. Plug it in again, or go on with the keys.", "error");
  }

  #pollPad() {
    if (this.pad === null) return;
    const pad = navigator.getGamepads()[this.pad];
    if (!pad || !pad.connected) { this.#lost(); return; } // some browsers send no event
    const dead = (x) => (Math.abs(x) < DEAD_ZONE ? 0 : Math.sign(x) * (Math.abs(x) - DEAD_ZONE) / (1 - DEAD_ZONE));
    const pressed = (k) => (pad.buttons[k]?.pressed ? 1 : 0);
    const slow = pressed(4) || pressed(5) || pressed(6) || pressed(7) ? SLOW : 1;
    const stick = (k) => [-dead(pad.axes[k + 1] ?? 0) * slow, dead(pad.axes[k] ?? 0) * slow];
    const [advance, rotate] = stick(0);
    const left = [advance + (pressed(12) - pressed(13)) * slow, rotate + (pressed(15) - pressed(14)) * slow];
    // of a gamepad that the browser does not know, the further axes may be anything: its one stick steers the wire
    const standard = pad.mapping === "standard";
    const axes = standard ? this.#axes(stick(2), left) : this.#axes(left, [0, 0]);
    this.padAxes = this.enabled ? axes : [0, 0, 0, 0];
    this.#changed();
  }

  // What both hands ask of wire and catheter.
  #axes(right, left) {
    return this.devices === 2 ? [...right, ...left] : [right[0] + left[0], right[1] + left[1], 0, 0];
  }

  #changed() {
    const speed = [...this.held.keys()].some((code) => KEYS[code] === "slow") ? SLOW : 1;
    const hands = [[0, 0], [0, 0]];
    for (const code of this.held.keys()) {
      if (KEYS[code] === "slow") continue;
      const [hand, axis, direction] = KEYS[code];
      hands[hand][axis] += direction;
    }
    const full = (x) => Math.max(-1, Math.min(1, x));
    const axes = this.#axes(hands[RIGHT], hands[LEFT])
      .map((x, k) => Math.round(full(full(x) * speed + this.padAxes[k]) * 100) / 100 + 0);
    if (axes.every((x, k) => x === this.last[k])) return;
    this.last = axes;
    this.send(axes);
  }
}
