"use strict";
// What is chosen: motor file, recordings, their columns and ranges. Files are brought in, looked at, taken out.
const PIECE = 1 << 20; // octets of a file that are sent at once; the server takes no more
const Files = {
  there: null, // what can be chosen
  chosen: {motor: "", recordings: [], judge: [], columns: [], ranges: [], voltage_commanded: false, terminal: "", shaft: ""},
  asked: null, // the first look, while it is under way
  change: () => {}, // called when the choice has changed

  async start(change) {
    this.change = change;
    $("motor").onchange = () => this.set({motor: $("motor").value});
    $("voltage_commanded").onchange = () => this.set({voltage_commanded: $("voltage_commanded").checked});
    for (const id of ["terminal", "shaft"]) $(id).onchange = () => this.set({[id]: $(id).value});
    $("refresh").onclick = () => this.read();
    $("undo").onclick = () => this.back(this.undoable());
    $("redo").onclick = () => this.back(this.redoable());
    $("send").onchange = () => { this.send([...$("send").files]); $("send").value = ""; };
    addEventListener("dragover", event => { if (event.dataTransfer.types.includes("Files")) { event.preventDefault(); document.body.classList.add("dropping"); } });
    addEventListener("dragleave", event => { if (!event.relatedTarget) document.body.classList.remove("dropping"); });
    addEventListener("drop", event => {
      event.preventDefault();
      document.body.classList.remove("dropping");
      this.send([...event.dataTransfer.files]);
    });
    await this.ready();
    // On a phone what is found out comes first, once something is chosen.
    if (matchMedia("(max-width: 56rem)").matches && this.chosen.motor && this.chosen.recordings.length) $("files").open = false;
  },

  // A step that is asked for before the page knows what is chosen waits for that.
  async ready() {
    if (!this.there) await (this.asked ??= this.read().finally(() => { this.asked = null; }));
  },

  async read(motor) {
    const there = await get("/choice"), first = !this.there;
    this.there = there;
    if (first) this.chosen = this.there.chosen;
    const names = this.there.motors.map(entry => entry.name);
    if (motor && names.includes(motor)) this.chosen.motor = motor;
    if (!names.includes(this.chosen.motor)) this.chosen.motor = names[0] || "";
    for (const list of ["recordings", "judge"]) this.chosen[list] = this.chosen[list].filter(name => this.there.recordings.includes(name));
    this.show();
  },

  // Only what the user chose is remembered; the page is drawn from it.
  set(part) {
    Object.assign(this.chosen, part);
    this.show();
    send("/choice", this.chosen);
  },

  show() {
    const {there, chosen} = this;
    // A file from elsewhere by its name alone, unless another is called so.
    const short = name => name.startsWith("/") ? name.split("/").pop().replace(/\.toml$/, "") : name, names = there.motors.map(entry => entry.name);
    $("motor").replaceChildren(...names.map(name => new Option(names.filter(other => short(other) === short(name)).length > 1 ? name : short(name), name)));
    $("motor").title = chosen.motor;
    if (!there.motors.length) $("motor").append(new Option("no motor file here", ""));
    $("motor").value = chosen.motor;
    $("voltage_commanded").checked = chosen.voltage_commanded;
    for (const id of ["terminal", "shaft"]) $(id).value = chosen[id];
    if (conditions(chosen)) $("conditions").open = true; // what is not as usual is seen
    const stated = this.stated(), present = this.parts().filter(name => !stated.includes(name));
    $("parts").textContent = (present.length ? `textbook + ${present.map(words).join(" + ")}` : "the textbook motor, no effects") + (stated.length ? `; stated, never fitted: ${stated.map(words).join(", ")}` : "");
    $("motor-file").hidden = !chosen.motor;
    $("motor-file").href = `/file?name=${encodeURIComponent(chosen.motor)}`;
    $("motor-file").download = chosen.motor.split("/").pop();
    for (const [id, name, word] of [["undo", this.undoable(), "Undo: back to"], ["redo", this.redoable(), "Redo:"]]) {
      $(id).hidden = !name;
      $(id).textContent = name ? `${word} ${name.split("/").pop()}` : "";
    }
    this.showRecordings();
    this.showSettings();
    this.change();
  },

  showRecordings() {
    const body = $("recordings").tBodies[0], focus = document.activeElement?.getAttribute?.("aria-label");
    body.replaceChildren(...this.there.recordings.map(name => {
      const row = put("tr");
      const file = put("td", row);
      const link = put("a", file, name);
      link.href = `/file?name=${encodeURIComponent(name)}`;
      link.download = name.split("/").pop();
      link.title = "download";
      for (const [list, other, label] of [["recordings", "judge", "use"], ["judge", "recordings", "judge by"]]) {
        const box = put("input", put("td", row));
        Object.assign(box, {type: "checkbox", name: label === "use" ? "use" : "judge", value: name, checked: this.chosen[list].includes(name)});
        box.setAttribute("aria-label", `${label} ${name}`);
        box.onchange = () => this.set({
          [list]: box.checked ? [...this.chosen[list], name] : this.chosen[list].filter(one => one !== name),
          [other]: box.checked ? this.chosen[other].filter(one => one !== name) : this.chosen[other],
        });
      }
      press(put("td", row), "Look", `Look at ${name}`, () => this.look(name));
      return row;
    }));
    if (!this.there.recordings.length) put("td", put("tr", body), "no recording here").colSpan = 4;
    if (focus) [...body.querySelectorAll("[aria-label]")].find(one => one.getAttribute("aria-label") === focus)?.focus();
  },

  // Columns and ranges that were chosen, each with the way to take it back.
  showSettings() {
    $("settings").replaceChildren();
    for (const [list, title, text] of [["columns", "Columns", one => { const [name, column] = columnParts(one); return `${name || "all"}: ${column.replace("=", " is ")}`; }], ["ranges", "Ranges", one => { const [name, span] = rangeParts(one); return `${name || "all"}: ${span.replace(":", " to ")} s`; }]]) {
      if (!this.chosen[list].length) continue;
      put("h2", $("settings"), title);
      const rows = put("ul", $("settings"));
      for (const one of this.chosen[list]) {
        const row = put("li", rows, `${text(one)} `);
        press(row, "Remove", `Remove ${text(one)}`, () => this.set({[list]: this.chosen[list].filter(other => other !== one)}));
      }
    }
  },

  look(name) {
    open_("look");
    return take({kind: "look", recordings: [name], judge: []});
  },

  // What a column of a recording is; "" if it is nothing.
  map(name, quantity, unit, heading) {
    const key = column => column.split("=")[0].replace(/^(load_torque|[a-z]+).*/, "$1");
    const others = this.chosen.columns.filter(text => {
      const [of, column] = columnParts(text);
      return of !== name || (key(column) !== quantity && column.slice(column.indexOf("=") + 1) !== heading);
    });
    this.set({columns: quantity ? [...others, `${name}::${quantity}${unit ? `_${unit}` : ""}=${heading}`] : others});
  },

  // The columns that count for some recordings.
  columnsOf(names, columns = this.chosen.columns) {
    return columns.filter(text => !columnParts(text)[0] || names.includes(columnParts(text)[0]));
  },

  // Times are those of the whole recording; a range of a range is counted from its start.
  range(name, from, to, order) {
    const path = [...order.recordings, ...order.judge].find(one => one.split("/").pop() === name) || name;
    const inside = order.ranges.find(one => rangeParts(one)[0] === path), start = inside ? Number(rangeParts(inside)[1].split(":")[0]) || 0 : 0;
    const text = `${path}=${[from, to].map(value => Number((value + start).toPrecision(7))).join(":")}`;
    this.set({ranges: [...this.chosen.ranges.filter(one => rangeParts(one)[0] !== path), text]});
    say(`The next steps use ${from.toFixed(3)} to ${to.toFixed(3)} s of ${name}.`);
  },

  parts() {
    return this.there?.motors.find(motor => motor.name === this.chosen.motor)?.parts || [];
  },

  // Those of the parts of which every value is stated, such as that a commanded voltage has no sensor.
  stated() {
    return this.there?.motors.find(motor => motor.name === this.chosen.motor)?.stated || [];
  },

  undoable() {
    return steps.findLast(step => step.written && step.written === this.chosen.motor)?.motor;
  },

  redoable() {
    return steps.findLast(step => step.written && step.motor === this.chosen.motor && step.written !== this.chosen.motor)?.written;
  },

  back(motor) {
    if (!motor || !this.there.motors.some(entry => entry.name === motor)) return problem(`${motor} is not here any more.`, "/choice");
    this.set({motor});
    say(`The motor file is ${motor}; the other one is kept.`);
  },

  // In pieces, so that neither side holds a large file.
  async send(list) {
    for (const file of list) {
      try {
        let path = null;
        for (let offset = 0; path === null; offset += PIECE) {
          $("sending").textContent = `${file.name}: ${Math.floor(100 * offset / Math.max(file.size, 1))} %`;
          const query = new URLSearchParams({name: file.name, offset, size: file.size});
          const reply = await fetch(`/upload?${query}`, {method: "POST", headers: {"Content-Type": "application/octet-stream"}, body: file.slice(offset, offset + PIECE)});
          const answer = await reply.json();
          if (!reply.ok) throw new Error(answer.error);
          path = answer.path;
          if (offset + PIECE >= file.size && path === null) throw new Error(`${file.name}: was not taken`);
        }
        $("sending").textContent = `${file.name}: here`;
        await this.read();
        if (path.endsWith(".toml")) this.set({motor: path});
        else {
          this.set({recordings: [...this.chosen.recordings, path]});
          if (list.length === 1) await this.look(path);
        }
      } catch (error) {
        $("sending").textContent = "";
        problem(error.message, "/upload");
      }
    }
  },
};

// What of the recordings is not as they say themselves, in words; "" if nothing.
function conditions({voltage_commanded, terminal, shaft}) {
  return [voltage_commanded && "voltage commanded", terminal && `terminals ${terminal}`, shaft && `shaft ${shaft}`].filter(Boolean).join(", ");
}

function columnParts(text) {
  const at = text.lastIndexOf("::");
  return at < 0 ? ["", text] : [text.slice(0, at), text.slice(at + 2)];
}

function rangeParts(text) {
  const at = text.lastIndexOf("=");
  return at < 0 ? ["", text] : [text.slice(0, at), text.slice(at + 1)];
}
