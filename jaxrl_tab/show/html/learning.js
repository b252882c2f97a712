// A slider over pictures of learning, with play and pause.

const at = (name) => document.getElementById(name);
const { sources, titles, seconds } = JSON.parse(at("data").textContent);
let playing = null;

function show() {
  const i = +at("moment").value;
  at("picture").src = sources[i];
  at("picture").alt = "What it has learned " + titles[i];
  at("title").textContent = titles[i];
  at("moment").setAttribute("aria-valuetext", titles[i]);
}

function stop() {
  clearInterval(playing);
  playing = null;
  at("play").textContent = "Play";
}

function next() {
  const slider = at("moment");
  if (slider.value === slider.max) return stop();
  slider.stepUp();
  show();
}

at("moment").oninput = () => {
  stop();
  show();
};
at("play").onclick = () => {
  if (playing !== null) return stop();
  if (at("moment").value === at("moment").max) at("moment").value = 0;
  show();
  at("play").textContent = "Pause";
  playing = setInterval(next, 1000 * seconds);
};
at("controls").hidden = false;
show();
