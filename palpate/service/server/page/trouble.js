// The error message, shown until an action succeeds.

import { Refused } from "./api.js";

const place = document.getElementById("trouble");

let ofConnection = false;
let complaints = 0;

export const complain = (error) => {
  ofConnection = false;
  if (error) complaints += 1;
  place.hidden = !error;
  place.textContent = error ? error.message || String(error) : "";
  if (error && !(error instanceof Refused)) console.error(error);
};

// Runs the action of a button and shows its error. A success clears only earlier messages: a
// list that was still loading does not hide the refusal of a token.
export const attempt = async (act) => {
  const before = complaints;
  try {
    const result = await act();
    if (complaints === before) complain(null);
    return result;
  } catch (error) {
    complain(error);
    return undefined;
  }
};

// A restored connection clears only its own message, not one from a button.
export const connected = (there) => {
  if (there && ofConnection) complain(null);
  if (there) return;
  complain(new Refused(0, "The service does not answer. This page will continue when it is back."));
  ofConnection = true;
};
