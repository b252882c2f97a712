// Numbers out of the page: the inverse of `packing.py`.

async function unpack(id) {
  const text = document.getElementById(id).textContent;
  const bytes = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

// float32, whose first bytes stand together, then their second ones, and so on.
async function floats(id) {
  const planes = await unpack(id);
  const n = planes.length / 4;
  const bytes = new Uint8Array(planes.length);
  for (let k = 0; k < 4; k++) for (let i = 0; i < n; i++) bytes[4 * i + k] = planes[k * n + i];
  return new Float32Array(bytes.buffer);
}

// Codes [views, moments, cells] as numbers: differences from moment to moment, as unsigned numbers, in two planes.
function decoded(bytes, offset, [views, moments, cells], low, step) {
  const n = views * moments * cells;
  const codes = new Uint16Array(n);
  const numbers = new Float64Array(n);
  for (let i = 0; i < n; i++) {
    const z = bytes[offset + i] | (bytes[offset + n + i] << 8);
    const first = i % (moments * cells) < cells;
    codes[i] = ((z >>> 1) ^ -(z & 1)) + (first ? 0 : codes[i - cells]);
    numbers[i] = codes[i] < 65533 ? low + codes[i] * step : [-Infinity, Infinity, NaN][codes[i] - 65533];
  }
  return numbers;
}

// The tables of a setting: functions of a view, a moment, and the place of a state.
async function tablesOf(id, about, states, ranks) {
  const bytes = await unpack(id);
  const { moments, averaged, actions, visited } = about;
  const more = averaged ? 1 : 0;
  const singles = ranks.length;
  const width = Math.ceil(actions / 8);
  const q = decoded(bytes, 0, [singles + 2 * more, moments, states * actions], about.low, about.step);
  let offset = 2 * q.length;
  const sets = offset;
  offset += (singles + more) * moments * states * width;
  const agree = offset;
  offset += more * moments * states;
  const shape = [singles + more, moments, states * visited];
  const visits = about.visits ? decoded(bytes, offset, shape, 0, about.visits) : null;
  const views = [...(averaged ? ["mean", "median"] : []), ...ranks];
  // Mean and median have the same vote, and the same visits.
  const place = (view) => Math.max(0, views.indexOf(view) - more);
  const at = (view, moment, s, of, count) => ((view * moments + moment) * of + s) * count;
  return {
    moments,
    averaged,
    views,
    actions,
    decimals: about.decimals,
    has: (view) => views.includes(view),
    q: (view, moment, s) => {
      const i = at(views.indexOf(view), moment, s, states, actions);
      return q.subarray(i, i + actions);
    },
    greedy: (view, moment, s) => {
      const i = sets + at(place(view), moment, s, states, width);
      const best = [];
      for (let a = 0; a < actions; a++) if ((bytes[i + (a >> 3)] >> (a & 7)) & 1) best.push(a);
      return best;
    },
    agree: (view, moment, s) => (view === "mean" || view === "median" ? bytes[agree + moment * states + s] / 100 : 1),
    visits: (view, moment, s) => {
      if (!visits) return null;
      const i = at(place(view), moment, s, states, visited);
      return visits.subarray(i, i + visited);
    },
  };
}
