// The daemon asks for its token.

import { post } from "../api.js";
import { field, h, say } from "../dom.js";

/** `from`: the view that was asked for, as it stands after the address; it is shown once the token is right. */
export function loginView(from) {
  const token = h("input", { type: "password", autocomplete: "current-password", required: true });
  const wrong = h("p", { class: "wrong", role: "alert" });
  const submit = async (event) => {
    event.preventDefault();
    try {
      await post("/login", { token: token.value });
      location.replace(from.startsWith("#/") ? from : "#/live");
    } catch (error) {
      say(wrong, error.message);
    }
  };
  const element = h(
    "form",
    { class: "card narrow", onsubmit: submit },
    h("h1", {}, "Log in"),
    h("p", {}, "This daemon asks for its token. It stands in the file that network.token_file of its configuration names."),
    field("Token", token),
    h("button", { type: "submit", class: "go" }, "Log in"),
    wrong,
  );
  return { title: "Log in", element };
}
